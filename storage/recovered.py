"""What came of putting a session right."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Recovery:
    """A session that was put right."""

    session: str
    rows: Mapping[str, int]  # that no manifest listed and that are back, by table
    adopted: tuple[str, ...]  # of these, the files that were whole and only had to be listed
    lost: tuple[str, ...]  # what could not be had and why, a line each; what was known before left out
    cut: tuple[str, ...]  # of these, those of the end only, where the recorder was cut off
    done: tuple[str, ...]  # what else was put right, a line each

    @property
    def complete(self) -> bool:
        """Whether all is back that had been written."""
        return not self.lost

    @property
    def changed(self) -> bool:
        """Whether anything was put right, or found to be lost."""
        return bool(self.rows or self.adopted or self.lost or self.done)
