"""Recordings and models on disk: datasets of Parquet parts that survive what happens to them."""

from storage.dataset import Dataset
from storage.models import identify_detector, load_debounce, load_detector, load_weights, save_weights
from storage.recovered import Recovery
from storage.recovery import recover
from storage.session import Session
from storage.verification import Verified, verify

__all__ = [
    "Dataset",
    "Recovery",
    "Session",
    "Verified",
    "identify_detector",
    "load_debounce",
    "load_detector",
    "load_weights",
    "recover",
    "save_weights",
    "verify",
]
