"""Modules of the train extra, which are imported on first use."""

from importlib import import_module
from typing import Any


def sklearn(module: str) -> Any:  # noqa: ANN401 - scikit-learn has no type annotations
    """Import a module of scikit-learn, which takes a second the first time."""
    return import_module(f"sklearn.{module}")
