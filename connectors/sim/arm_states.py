"""What an arm does at a series of instants."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from operators.batch import Reals


@dataclass(frozen=True, slots=True)
class Path:
    """Where the arm is, how it moves and how hard it presses at k instants."""

    drive: Reals  # (k, 6) what follows, side by side
    place: Reals  # (k, 3) m, m, rad of the TCP, seen along the normal from where it began

    @classmethod
    def blank(cls, k: int) -> "Path":
        """Nothing yet, at k instants."""
        return cls(np.zeros((k, 6)), np.zeros((k, 3)))

    @property
    def velocity(self) -> Reals:
        """Of the TCP in the fingertip's frame, a view: (k, 3) m/s, m/s, rad/s."""
        return self.drive[:, :3]

    @property
    def force(self) -> Reals:
        """Normal force, a view: (k,) N."""
        return self.drive[:, 3]

    @property
    def push(self) -> Reals:
        """From outside, in the fingertip's frame, a view: (k, 2) N."""
        return self.drive[:, 4:]

    def __len__(self) -> int:
        return len(self.place)

    def __getitem__(self, rows: slice) -> "Path":
        """A view of some of the instants."""
        return Path(self.drive[rows], self.place[rows])

    def without(self, rows: NDArray[np.intp]) -> "Path":
        """A copy without some of the instants."""
        return Path(np.delete(self.drive, rows, axis=0), np.delete(self.place, rows, axis=0))
