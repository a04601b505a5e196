"""Recipes of public datasets: download, verification and import."""
