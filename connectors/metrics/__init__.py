"""What a run measures of itself, for Prometheus to collect."""
