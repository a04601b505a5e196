"""Comparison of detectors by speed and accuracy."""
