"""Emulated devices that serve the simulated scene over real protocols."""
