"""Recorded traces in CSV and other file formats."""
