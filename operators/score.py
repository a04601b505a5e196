"""How sure a detector is of slip, instant by instant."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from operators.batch import BAROMETERS, Counts, Scores, Zeroed
from operators.detectors.detector import Detector
from operators.errors import ParameterError
from operators.hold import hold
from operators.operator import Operator
from operators.window import Window

_BLOCK: Final = 64  # windows that a detector is given at once: few enough to stay in cache
_MISSING: Final = 3  # cells of the newest sample that may be invalid


@dataclass
class Score(Operator[Zeroed, Scores]):
    """The detector's judgement of the window behind every `hop`-th sample; none before the first full one.

    A cell that did not answer is taken to read what it read last, or 0 before it ever did. Where more than
    three cells of the newest sample did not answer, the score is NaN.
    """

    detector: Detector
    hop: int = 1  # samples
    _window: Window = field(init=False, repr=False, compare=False)
    _last: Counts = field(init=False, repr=False, compare=False)  # (6,) last valid

    def __post_init__(self) -> None:
        if self.hop < 1:
            raise ParameterError("Score", "hop", self.hop, "at least 1")
        self._window = Window(self.detector.length, self.hop)
        self._last = np.zeros(BAROMETERS, np.int16)

    def process(self, batch: Zeroed) -> Scores:
        """Give a score for each window whose newest sample is in the batch."""
        counts = hold(batch.counts, batch.valid, self._last)
        answered = counts is batch.counts
        if not answered:
            batch = Zeroed(batch.time, counts, batch.temperature, batch.valid, finger=batch.finger)
        self._last = counts[-1]
        windows = self._window.process(batch)
        size = len(windows)
        if not size:
            return Scores.empty()
        counts = windows.counts
        if size <= _BLOCK:
            probability = self.detector.score(counts)
        else:
            blocks = range(0, size, _BLOCK)
            probability = np.concatenate([self.detector.score(counts[i : i + _BLOCK]) for i in blocks])
        if not answered:
            missing = BAROMETERS - windows.valid[:, -1].sum(axis=1)  # (n,)
            probability = np.where(missing > _MISSING, np.nan, probability)
        return Scores(windows.time, probability, finger=batch.finger)
