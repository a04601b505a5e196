"""Web pages and metrics: a live page of a run, a page of a recorded session, and Prometheus metrics."""
