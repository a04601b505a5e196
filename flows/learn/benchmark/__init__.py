"""Benchmark of slip detectors on real recordings, split by surface, object or recording."""
