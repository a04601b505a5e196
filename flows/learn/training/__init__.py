"""Training of slip detectors."""
