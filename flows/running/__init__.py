"""The runners: live, and over recordings."""
