"""Runners that execute a flow live or over recordings."""
