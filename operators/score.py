"""Scoring of samples by a detector."""

from dataclasses import dataclass, field, replace
from numbers import Integral
from typing import Any, Final, Self, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from operators.batch import Counts, Flags, Reals, Scores, Zeroed
from operators.detectors.detector import Detector, StreamingDetector
from operators.errors import BatchError, ParameterError
from operators.fingertip import Fingertip
from operators.operator import Operator
from operators.segment import compiler
from operators.steps import RowType, Steps
from operators.window import Window

Scalar = TypeVar("Scalar", bound=np.generic)
_ROUNDING: Final = 1e-6  # by which a sum of probabilities of 32 bits may be above 1
_BLOCK: Final = 64  # windows per call of a detector; few enough to stay in the cache


@dataclass
class Score(Operator[Zeroed, Scores]):
    """Compute a detector's slip probability at every sample from the first full window on.

    Invalid cells take their last valid counts, or 0 before the first. If more than half of the cells of the
    newest sample are invalid, the score is NaN.

    Streaming detectors process each sample once. If numba, which compiles them, is not installed, they
    process windows like the other detectors, which takes several times the CPU time.

    Args:
        detector: Slip detector.

    Raises:
        ParameterError: if the detector's length is below 1, or `detector` is not an object with `score`, such
            as the name or the class of a detector.

    >>> from operators.detectors import Psd
    >>> cells = np.zeros((30, 6), np.int16)
    >>> len(Score(Psd(length=25)).push(Zeroed(np.arange(30), cells, cells, cells == 0)))
    6
    """

    detector: Detector
    _last: Counts | None = field(default=None, init=False, repr=False, compare=False)  # (cells,) last valid
    _window: Window = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        given: Any = self.detector
        length = getattr(given, "length", None)
        if isinstance(given, type) or not (hasattr(given, "score") and isinstance(length, Integral)):
            must_be = "an object with name, length (whole samples) and score: Psd() or load_detector('tcn')"
            raise ParameterError("Score", "detector", given, must_be)
        self._window = Window(given.length)

    def for_fingertip(self, given: Fingertip) -> Self:
        """Return the operator with the detector for this fingertip, if it makes a difference.

        Raises:
            FingertipError: if the detector was made for another number of cells, rate or unit.
        """
        adapted = getattr(self.detector, "for_fingertip", None)
        return replace(self, detector=adapted(given)) if adapted else self

    def steps(self, *given: RowType) -> Steps | None:
        """Return the step of a streaming detector; None for others, or if numba is not installed."""
        if compiler() is None or not isinstance(self.detector, StreamingDetector):
            return None
        return self.detector.steps(given[0].cells)

    def process(self, batch: Zeroed) -> Scores:
        """Return a score for each window whose newest sample is in the batch."""
        counts = forward_fill(batch.counts, batch.valid, self._last)
        self._last = counts[-1]
        filled = Zeroed(batch.time, counts, batch.temperature, batch.valid, finger=batch.finger)
        windows = self._window.process(filled)
        if not len(windows):
            return Scores.empty()
        blocks = range(0, len(windows), _BLOCK)
        scores = [self._checked_scores(windows.counts[i : i + _BLOCK]) for i in blocks]
        probability = np.concatenate(scores, dtype=np.float64)
        newest = windows.valid[:, -1]  # (n, cells)
        few = np.count_nonzero(newest, axis=1) * 2 < newest.shape[1]  # (n,)
        probability[few] = np.nan
        return Scores(windows.time, probability, finger=batch.finger)

    def _checked_scores(self, windows: Counts) -> Reals:
        """Return the detector's scores of windows, after a check of their type, shape and values."""
        name, scores = type(self.detector).__name__, self.detector.score(windows)
        is_array, shape = isinstance(cast("object", scores), np.ndarray), (len(windows),)
        if not is_array or scores.dtype.kind != "f" or scores.shape != shape:
            has = f"{scores.dtype} of shape {scores.shape}" if is_array else type(scores).__name__
            reason = f"{name}.score returned {has}, must return an array of floats of shape {shape}"
            raise BatchError("Scores", "probability", reason)
        if (wrong := scores[(scores < -_ROUNDING) | (scores > 1 + _ROUNDING)]).size:
            reason = f"{name}.score returned {wrong[0]!s}, must return numbers from 0 to 1, or NaN"
            raise BatchError("Scores", "probability", reason)
        return np.clip(scores, 0, 1)


def forward_fill(
    values: NDArray[Scalar], valid: Flags, last: NDArray[Scalar] | None = None
) -> NDArray[Scalar]:
    """Replace each invalid value by the last valid one of its column.

    Args:
        values: (n, m)
        valid: (n, m)
        last: (m,) replacements before the first valid value; None: 0

    >>> values, valid = np.array([[7], [0], [9]]), np.array([[True], [False], [True]])
    >>> forward_fill(values, valid).ravel()
    array([7, 7, 9])
    """
    if b"\0" not in valid.tobytes():  # all are valid; five times as fast as numpy for one row
        return values
    source = np.where(valid, np.arange(1, len(values) + 1)[:, None], 0)  # (n, m) 0: `last`
    np.maximum.accumulate(source, axis=0, out=source)
    first = np.zeros_like(values[:1]) if last is None else last[None]
    return np.take_along_axis(np.concatenate((first, values)), source, axis=0)
