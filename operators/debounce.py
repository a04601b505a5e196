"""Debouncing of slip probabilities."""

from dataclasses import dataclass, field

import numpy as np

from operators.batch import SLIP, STATIC, UNKNOWN, Scores, Slips
from operators.checks import check_at_least
from operators.errors import ParameterError
from operators.operator import Operator


@dataclass
class Debounce(Operator[Scores, Slips]):
    """Convert slip probabilities to slip events: onset and end.

    A slip starts after `consecutive` decisions for slip in a row, and ends after `release` decisions against
    it. NaN is not a decision and interrupts either run. A slip that is open when the stream ends gets no end.

    Args:
        threshold: Smallest probability that is a decision for slip, above 0, at most 1.
        consecutive: Decisions that start a slip; 2 in the paper's robot tests.
        release: Decisions that end a slip.
        minimum: Shortest duration of a slip, ns, from the first decision of its onset.

    Raises:
        ParameterError: if a parameter is invalid.

    References:
        "Under Pressure" (2021), section V-B.

    >>> scores = Scores(np.arange(5), np.array([0.9, 0.8, 0.9, 0.1, 0.2]))
    >>> slips = Debounce().push(scores)
    >>> slips.state, slips.start, slips.time
    (array([1, 0], dtype=int8), array([0, 3]), array([1, 4]))
    """

    threshold: float = 0.5
    consecutive: int = 2
    release: int = 2
    minimum: int = 0
    _decision: int = field(default=UNKNOWN, init=False, repr=False)  # of the current run
    _length: int = field(default=0, init=False, repr=False)  # decisions in the current run
    _start: int = field(default=0, init=False, repr=False)  # ns, start of the current run
    _state: int = field(default=STATIC, init=False, repr=False)  # SLIP during a slip
    _earliest: int = field(default=0, init=False, repr=False)  # ns, earliest end of the current slip

    def __post_init__(self) -> None:
        if not 0 < self.threshold <= 1:
            raise ParameterError("Debounce", "threshold", self.threshold, "above 0 and at most 1")
        check_at_least("Debounce", "consecutive", self.consecutive, 1, "decision")
        check_at_least("Debounce", "release", self.release, 1, "decision")
        check_at_least("Debounce", "minimum", self.minimum, 0, "ns")

    def process(self, batch: Scores) -> Slips:
        """Return the onsets and ends within the batch."""
        threshold, consecutive, release = self.threshold, self.consecutive, self.release
        run, length, start, state = self._decision, self._length, self._start, self._state
        rows: list[int] = []
        starts: list[int] = []
        states: list[int] = []
        values = zip(batch.time.tolist(), batch.probability.tolist(), strict=True)
        for row, (time, probability) in enumerate(values):  # Python floats: as fast as numpy here
            decision = SLIP if probability >= threshold else STATIC if probability < threshold else UNKNOWN
            if decision == run:
                length += 1
            else:
                run, length, start = decision, 1, time
            if state == STATIC:
                changes = decision == SLIP and length >= consecutive
            else:
                changes = decision == STATIC and length >= release and time >= self._earliest
            if changes:
                state, self._earliest = decision, start + self.minimum
                rows.append(row)
                starts.append(start)
                states.append(state)
        self._decision, self._length, self._start, self._state = run, length, start, state
        if not rows:
            return Slips.empty()
        return Slips(
            batch.time[rows],
            np.array(states, np.int8),
            np.array(starts, np.int64),
            batch.probability[rows],
            finger=batch.finger,
        )
