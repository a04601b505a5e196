"""Result of a recovery."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Recovery:
    """Result of a recovery."""

    session: str
    rows: Mapping[str, int]  # recovered rows by table
    adopted: tuple[str, ...]  # complete files that were not in the manifest
    lost: tuple[str, ...]  # a line for each loss that was not known before
    cut: tuple[str, ...]  # those of `lost` at the end, where the recorder was killed
    done: tuple[str, ...]  # a line for each other repair

    @property
    def complete(self) -> bool:
        """True if nothing was lost."""
        return not self.lost

    @property
    def changed(self) -> bool:
        """True if anything was repaired or lost."""
        return bool(self.rows or self.adopted or self.lost or self.done)
