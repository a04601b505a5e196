"""Recordings and models on disk: datasets of Parquet parts that survive what happens to them."""

from storage.dataset import Dataset
from storage.models import load_debounce, load_detector, load_weights, save_weights
from storage.session import Session

__all__ = ["Dataset", "Session", "load_debounce", "load_detector", "load_weights", "save_weights"]
