"""How sure a detector is of slip, instant by instant."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from operators.batch import BAROMETERS, Counts, Reals, Scores, Zeroed, maker
from operators.detectors.detector import Detector, Stream, Streaming
from operators.errors import ParameterError
from operators.forward_fill import forward_fill
from operators.operator import Operator
from operators.window import Window

_BLOCK: Final = 64  # windows that a detector is given at once: few enough to stay in cache
MISSING: Final = 3  # cells of the newest sample that may be invalid
_made: Final = maker(Scores)


@dataclass
class Score(Operator[Zeroed, Scores]):
    """The detector's judgement of the window behind every `hop`-th sample; none before the first full one.

    A cell that did not answer is taken to read what it read last, or 0 before it ever did. Where more than
    three cells of the newest sample did not answer, the score is NaN.

    A detector that can is streamed: it is given each sample once, and no window is kept. Where numba, which
    compiles that, is not installed, it is given windows as the others are, for several times the CPU.

    Raises:
        ParameterError: if `hop` is no number of samples.
    """

    detector: Detector
    hop: int = 1  # samples
    _way: "_Streamed | _Windowed" = field(init=False, repr=False, compare=False)
    _last: Counts = field(init=False, repr=False, compare=False)  # (6,) last valid
    _due: int = field(default=0, init=False, repr=False)  # samples until the next score

    def __post_init__(self) -> None:
        if self.hop < 1:
            raise ParameterError("Score", "hop", self.hop, "at least 1 sample")
        stream = _stream(self.detector)
        windowed = _Windowed(self.detector, Window(self.detector.length, self.hop))
        self._way = windowed if stream is None else _Streamed(stream)
        self._last = np.zeros(BAROMETERS, np.int16)
        self._due = self.detector.length

    def process(self, batch: Zeroed) -> Scores:
        """Give a score for each window whose newest sample is in the batch."""
        counts = forward_fill(batch.counts, batch.valid, self._last)
        answered = counts is batch.counts
        if not answered:
            batch = Zeroed(batch.time, counts, batch.temperature, batch.valid, finger=batch.finger)
        self._last = counts[-1]
        rows = slice(self._due - 1, None, self.hop)  # that are judged
        probability = self._way.judge(batch, rows)
        self._due += len(probability) * self.hop - len(counts)
        if not len(probability):
            return Scores.empty()
        if not answered:
            missing = BAROMETERS - batch.valid[rows].sum(axis=1)  # (n,)
            probability = np.where(missing > MISSING, np.nan, probability)
        return _made(batch.time[rows], probability, batch.finger)


def _stream(detector: Detector) -> Stream | None:
    """A stream of a detector that can; None where it cannot, or a small install leaves out its compiler."""
    try:
        return detector.stream() if isinstance(detector, Streaming) else None
    except ModuleNotFoundError as error:
        if error.name != "numba":
            raise
        return None


@dataclass
class _Streamed:
    """Has the detector remember the past."""

    stream: Stream

    def judge(self, batch: Zeroed, rows: slice) -> Reals:
        return self.stream.push(batch.counts[:, None])[rows, 0]


@dataclass
class _Windowed:
    """Gives the detector windows, those whose newest samples are the rows."""

    detector: Detector
    window: Window

    def judge(self, batch: Zeroed, rows: slice) -> Reals:  # noqa: ARG002 - the window counts on its own
        windows, score = self.window.process(batch).counts, self.detector.score
        if len(windows) <= _BLOCK:
            return score(windows) if len(windows) else np.empty(0)
        blocks = range(0, len(windows), _BLOCK)
        return np.concatenate([score(windows[i : i + _BLOCK]) for i in blocks])
