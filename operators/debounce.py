"""Debouncing of slip probabilities."""

from dataclasses import dataclass, field

import numpy as np

from operators.batch import SLIP, STATIC, UNKNOWN, Reals, Scores, Slips, Times
from operators.checks import check_at_least
from operators.errors import ParameterError
from operators.operator import Operator
from operators.row_loop import Ints, row_loop


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
    _state: Times = field(init=False, repr=False, compare=False)
    _limits: Ints = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not 0 < self.threshold <= 1:
            raise ParameterError("Debounce", "threshold", self.threshold, "above 0 and at most 1")
        check_at_least("Debounce", "consecutive", self.consecutive, 1, "decision")
        check_at_least("Debounce", "release", self.release, 1, "decision")
        check_at_least("Debounce", "minimum", self.minimum, 0, "ns")
        self._limits = self.consecutive, self.release, self.minimum
        self._state = np.array([UNKNOWN, 0, 0, STATIC, 0])

    def process(self, batch: Scores) -> Slips:
        """Return the onsets and ends within the batch."""
        events = np.empty((3, batch.time.size), np.int64)
        threshold = float(self.threshold)
        count = _debounce(batch.time, batch.probability, threshold, self._limits, self._state, events)
        if not count:
            return Slips.empty()
        rows, starts, states = events[:, :count].copy()  # not views: sinks may keep the few events
        probability = batch.probability[rows]
        return Slips(batch.time[rows], states.astype(np.int8), starts, probability, finger=batch.finger)


# State: decision of the current run, its length and start (ns); SLIP during a slip, and its earliest end (ns)
_DECISION, _LENGTH, _START, _STATE, _EARLIEST = range(5)


@row_loop
def _debounce(
    time: Times, probability: Reals, /, threshold: float, limits: Ints, state: Times, events: Times
) -> int:
    """Write row, start and state of each event, and return their number."""
    consecutive, release, minimum = limits
    count = 0
    for row in range(len(time)):
        value = probability[row]
        decision = SLIP if value >= threshold else STATIC if value < threshold else UNKNOWN
        if decision == state[_DECISION]:
            state[_LENGTH] += 1
        else:
            state[_DECISION], state[_LENGTH], state[_START] = decision, 1, time[row]
        if state[_STATE] == STATIC:
            changes = decision == SLIP and state[_LENGTH] >= consecutive
        else:
            long_enough = state[_LENGTH] >= release and time[row] >= state[_EARLIEST]
            changes = decision == STATIC and long_enough
        if changes:
            state[_STATE], state[_EARLIEST] = decision, state[_START] + minimum
            events[0, count], events[1, count], events[2, count] = row, state[_START], decision
            count += 1
    return count
