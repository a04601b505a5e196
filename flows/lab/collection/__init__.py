"""Collection of recordings with a robot arm."""
