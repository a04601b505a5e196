"""Traces of others as CSV, their columns mapped."""
