"""What a slip detector is."""

from typing import Protocol

from operators.batch import Counts, Reals


class Detector(Protocol):
    """Judges windows of counts, each by itself: what stands beside it in the array changes no bit."""

    @property
    def name(self) -> str:
        """What it is called on the command line and in reports."""
        ...

    @property
    def length(self) -> int:
        """Samples of one window."""
        ...

    def score(self, windows: Counts | Reals) -> Reals:
        """How sure it is that the newest sample of each window is slip.

        Args:
            windows: (n, length, 6) zeroed counts, newest last; not to be written to

        Returns:
            (n,) 0 to 1
        """
        ...
