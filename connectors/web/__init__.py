"""The live page and the metrics endpoint, served over HTTP."""
