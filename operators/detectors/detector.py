"""What a slip detector is."""

from typing import Protocol, runtime_checkable

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


class Stream(Protocol):
    """A streaming detector at work on some fingertips; pickles with what it remembers."""

    def push(self, counts: Counts | Reals) -> Reals:
        """Take the next samples in order.

        Args:
            counts: (n, fingers, 6) zeroed counts

        Returns:
            (n, fingers) how sure it is that each sample is slip; once `length` samples were pushed, what
            `score` says of the window behind it, to 1e-5. However the samples are cut, the same bits.
        """
        ...


@runtime_checkable
class Streaming(Detector, Protocol):
    """A detector that remembers what it needs of the past, so that a sample costs little."""

    def stream(self, fingers: int = 1) -> Stream:
        """A new stream that has seen nothing, of `fingers` fingertips that are sampled together."""
        ...
