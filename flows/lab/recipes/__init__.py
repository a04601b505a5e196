"""Recipes of public datasets: Python functions that turn the published files into DataFrames."""
