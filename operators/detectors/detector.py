"""Interfaces of slip detectors."""

from typing import Protocol, runtime_checkable

from operators.batch import Counts, Reals
from operators.fingertip import Fingertip


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
class ForFingertip(Detector, Protocol):
    """Detector that was made for a certain fingertip."""

    def check_fingertip(self, given: Fingertip) -> None:
        """Check that the detector was made for this fingertip.

        Raises:
            FingertipError: if it was not; it names the operators that convert the data.
        """
        ...


class Stream(Protocol):
    """State of a streaming detector for one or more fingertips."""

    def push(self, counts: Counts | Reals) -> Reals:
        """Process the next samples in order.

        Args:
            counts: (n, fingers, cells) zeroed counts

        Returns:
            (n, fingers) probability of slip at each sample. After `length` samples it agrees with `score` of
            the same window to 1e-5. Cutting the samples anywhere changes no bit.
        """
        ...


@runtime_checkable
class Streaming(Detector, Protocol):
    """Detector that can process samples one by one, at low cost per sample."""

    def stream(self, fingers: int = 1) -> Stream:
        """Return a new stream for `fingers` fingertips that are sampled together."""
        ...
