"""Evaluation of slip detectors on labelled recordings."""
