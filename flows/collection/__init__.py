"""Collecting: an arm carries out a plan of strokes while a flow records what a fingertip feels."""
