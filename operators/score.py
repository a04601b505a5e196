"""Scoring of samples by a detector."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np

from operators.batch import BAROMETERS, Counts, Reals, Scores, Zeroed
from operators.checks import check_at_least
from operators.detectors.detector import Detector, Stream, Streaming
from operators.forward_fill import forward_fill
from operators.operator import Operator
from operators.window import Window

_BLOCK: Final = 64  # windows per call of a detector; few enough to stay in the cache
MISSING: Final = 3  # largest number of invalid cells in the newest sample


@dataclass
class Score(Operator[Zeroed, Scores]):
    """Compute a detector's slip probability at every `hop`-th sample, starting with the first full window.

    Invalid cells take their last valid counts, or 0 before the first. If more than three cells of the newest
    sample are invalid, the score is NaN.

    Streaming detectors process each sample once. If numba, which compiles them, is not installed, they
    process windows like the other detectors, which takes several times the CPU time.

    Args:
        detector: Slip detector.
        hop: Distance between scores, samples.

    Raises:
        ParameterError: if `hop` is below 1.

    >>> from operators.detectors import Psd
    >>> cells = np.zeros((30, 6), np.int16)
    >>> len(Score(Psd(length=25)).push(Zeroed(np.arange(30), cells, cells, cells == 0)))
    6
    """

    detector: Detector
    hop: int = 1
    _last: Counts = field(init=False, repr=False, compare=False)  # (6,) last valid counts
    _due: int = field(default=0, init=False, repr=False)  # samples until the next score

    def __post_init__(self) -> None:
        check_at_least("Score", "hop", self.hop, 1, "sample")
        self._last = np.zeros(BAROMETERS, np.int16)
        self._due = self.detector.length

    @cached_property
    def _scorer(
        self,
    ) -> "_Streamed | _Windowed":  # created when used: a stream loads numba, which takes 0.8 s
        stream = _stream(self.detector)
        windowed = _Windowed(self.detector, Window(self.detector.length, self.hop))
        return windowed if stream is None else _Streamed(stream)

    def prepare(self) -> None:
        """Create the detector's stream."""
        _ = self._scorer

    def process(self, batch: Zeroed) -> Scores:
        """Return a score for each window whose newest sample is in the batch."""
        counts = forward_fill(batch.counts, batch.valid, self._last)
        complete = counts is batch.counts
        if not complete:
            batch = Zeroed(batch.time, counts, batch.temperature, batch.valid, finger=batch.finger)
        self._last = counts[-1]
        rows = slice(self._due - 1, None, self.hop)  # to be scored
        probability = self._scorer.score(batch, rows)
        self._due += len(probability) * self.hop - len(counts)
        if not len(probability):
            return Scores.empty()
        if not complete:
            missing = BAROMETERS - batch.valid[rows].sum(axis=1)  # (n,)
            probability = np.where(missing > MISSING, np.nan, probability)
        return Scores(batch.time[rows], probability, finger=batch.finger)


def _stream(detector: Detector) -> Stream | None:
    """Return a stream of a streaming detector; None for others, or if numba is not installed."""
    try:
        return detector.stream() if isinstance(detector, Streaming) else None
    except ModuleNotFoundError as error:
        if error.name != "numba":
            raise
        return None


@dataclass
class _Streamed:
    """Scoring sample by sample."""

    stream: Stream

    def score(self, batch: Zeroed, rows: slice) -> Reals:
        return self.stream.push(batch.counts[:, None])[rows, 0]


@dataclass
class _Windowed:
    """Scoring window by window."""

    detector: Detector
    window: Window

    def score(self, batch: Zeroed, rows: slice) -> Reals:  # noqa: ARG002 - `Window` selects the same rows
        windows, score = self.window.process(batch).counts, self.detector.score
        if len(windows) <= _BLOCK:
            return score(windows) if len(windows) else np.empty(0)
        blocks = range(0, len(windows), _BLOCK)
        return np.concatenate([score(windows[i : i + _BLOCK]) for i in blocks])
