"""Data collection, robot experiments and simulated datasets."""
