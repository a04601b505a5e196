"""Judging detectors beside each other: their samples, events, motions and speed, and where each one fails."""
