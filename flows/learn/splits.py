"""Splits of a dataset by recording, and the order in which recordings are assigned to them."""

from typing import Final

SPLITS: Final = ("train", "validation", "test")
TURNS: Final = ("train", "train", "test", "train", "validation", "train", "train", "test", "train", "train")
