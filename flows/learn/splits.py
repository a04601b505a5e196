"""The splits of a dataset, by recording, and how recordings take turns at them."""

from typing import Final

SPLITS: Final = ("train", "validation", "test")
TURNS: Final = ("train", "train", "test", "train", "validation", "train", "train", "test", "train", "train")
