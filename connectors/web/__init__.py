"""Serving over HTTP, to those who may see it."""
