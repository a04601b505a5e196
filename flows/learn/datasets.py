"""Datasets of recordings: their splits, and their identity."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from storage.layout import MANIFEST, SESSIONS

SPLITS: Final = ("train", "validation", "test")
# of recordings without a split, in turn
TURNS: Final = ("train", "train", "test", "train", "validation", "train", "train", "test", "train", "train")


def dataset_digest(dataset: Path) -> str:
    """Return the sha256 of a dataset: of its sessions' manifests, which contain the sha256 of every part."""
    digest = hashlib.sha256()
    for manifest in sorted((dataset / SESSIONS).glob(f"*/{MANIFEST}")):
        digest.update(manifest.parent.name.encode() + b"\0" + manifest.read_bytes())
    return digest.hexdigest()


def learned_from(card: Mapping[str, Any], path: Path) -> bool:
    """Return True if a model's card states that it was trained or chosen on a dataset.

    Args:
        card: Content of the card.
        path: Folder of the dataset, or of one of its sessions.
    """
    dataset = path.resolve()
    if dataset.parent.name == SESSIONS:
        dataset = dataset.parent.parent
    stated = {each.get("sha256") for each in card.get("data", ())}
    return dataset_digest(dataset) in stated
