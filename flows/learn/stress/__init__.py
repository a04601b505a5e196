"""Evaluation of detectors under simulated stress."""
