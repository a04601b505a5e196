"""Interface of slip detectors."""

from typing import Protocol

from operators.batch import Counts, Reals


class Detector(Protocol):
    """Slip detector on windows; each result depends on its own window only, bit for bit."""

    @property
    def name(self) -> str:
        """Name on the command line and in reports."""
        ...

    @property
    def length(self) -> int:
        """Length of a window, samples."""
        ...

    def score(self, windows: Counts | Reals) -> Reals:
        """Return the probability that the newest sample of each window is slip.

        Args:
            windows: (n, length, cells) zeroed counts, newest last; read-only

        Returns:
            (n,) 0 to 1
        """
        ...
