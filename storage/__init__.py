"""Recordings and models on disk; recordings are datasets of Parquet parts that survive crashes."""

from storage.dataset import Dataset
from storage.hand_labels import HandLabels, LabelSpan
from storage.models import identify_detector, load_debounce, load_detector, save_weights
from storage.recovery import Recovery, recover
from storage.session import Session
from storage.verification import Verified, verify

__all__ = [
    "Dataset",
    "HandLabels",
    "LabelSpan",
    "Recovery",
    "Session",
    "Verified",
    "identify_detector",
    "load_debounce",
    "load_detector",
    "recover",
    "save_weights",
    "verify",
]
