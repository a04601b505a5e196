"""Adaptation of a trained network to another fingertip: without labels, or with few."""
