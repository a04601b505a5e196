"""Flows that run as they are: their parameters are their arguments."""
