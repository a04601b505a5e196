"""Collection of recordings with a robot arm, by plans in TOML files."""
