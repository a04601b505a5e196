"""Training, evaluation and comparison of slip detectors."""
