"""Report pages with figures and tables."""
