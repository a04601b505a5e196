"""Identity of datasets."""

import hashlib
from pathlib import Path

from storage.layout import MANIFEST, SESSIONS


def dataset_digest(dataset: Path) -> str:
    """Return the sha256 of a dataset: of its sessions' manifests, which contain the sha256 of every part."""
    digest = hashlib.sha256()
    for manifest in sorted((dataset / SESSIONS).glob(f"*/{MANIFEST}")):
        digest.update(manifest.parent.name.encode() + b"\0" + manifest.read_bytes())
    return digest.hexdigest()
