"""Detectors, judged beside each other: how right they are, what their users feel, how sure they may be."""
