"""Interfaces of slip detectors."""

from typing import Protocol, runtime_checkable

from operators.batch import Counts, Reals
from operators.steps import Steps


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


@runtime_checkable
class StreamingDetector(Detector, Protocol):
    """Detector that also processes samples one by one, each once, at low cost per sample."""

    def steps(self, cells: int) -> Steps:
        """Return the step from zeroed touch of this many cells to scores, which `Score` runs.

        They start at the `length`-th sample and agree with `score` of the same window to 1e-5. Without numba,
        `Score` does not call this.

        Raises:
            ParameterError: if the detector is for another number of cells.
        """
        ...
