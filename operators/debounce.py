"""Slip events out of single decisions."""

from dataclasses import dataclass, field

import numpy as np

from operators.batch import SLIP, STATIC, UNKNOWN, Scores, Slips
from operators.errors import ParameterError
from operators.operator import Operator


@dataclass
class Debounce(Operator[Scores, Slips]):
    """A slip begins after `consecutive` slip decisions in a row and ends after `release` static ones.

    The paper's robot tests register a slip after two. A NaN score decides nothing and breaks either run. A
    slip lasts at least `minimum` from its start, the first decision of its run: an end that would come
    sooner waits. A slip still open when the stream ends is given no end.

    Raises:
        ParameterError: on a value that cannot be used.

    >>> scores = Scores(np.arange(5), np.array([0.9, 0.8, 0.9, 0.1, 0.2]))
    >>> slips = Debounce().push(scores)
    >>> slips.state, slips.start, slips.time
    (array([1, 0], dtype=int8), array([0, 3]), array([1, 4]))
    """

    threshold: float = 0.5  # the least probability that is a slip decision
    consecutive: int = 2  # decisions
    release: int = 2  # decisions
    minimum: int = 0  # ns
    _decision: int = field(default=UNKNOWN, init=False, repr=False)  # of the run at hand
    _length: int = field(default=0, init=False, repr=False)  # of the run at hand, decisions
    _start: int = field(default=0, init=False, repr=False)  # of the run at hand, ns
    _state: int = field(default=STATIC, init=False, repr=False)  # SLIP while a slip lasts
    _earliest: int = field(default=0, init=False, repr=False)  # that the slip at hand may end, ns

    def __post_init__(self) -> None:
        if not 0 < self.threshold <= 1:
            raise ParameterError("Debounce", "threshold", self.threshold, "above 0 and at most 1")
        for name, least, unit in (
            ("consecutive", 1, "decision"),
            ("release", 1, "decision"),
            ("minimum", 0, "ns"),
        ):
            if getattr(self, name) < least:
                raise ParameterError("Debounce", name, getattr(self, name), f"at least {least} {unit}")

    def process(self, batch: Scores) -> Slips:
        """Give the onsets and ends that the batch decides."""
        threshold, consecutive, release = self.threshold, self.consecutive, self.release
        run, length, start, state = self._decision, self._length, self._start, self._state
        rows: list[int] = []
        starts: list[int] = []
        states: list[int] = []
        values = zip(batch.time.tolist(), batch.probability.tolist(), strict=True)
        for row, (time, probability) in enumerate(values):  # on floats: as fast as arrays of whole runs
            decision = SLIP if probability >= threshold else STATIC if probability < threshold else UNKNOWN
            if decision == run:
                length += 1
            else:
                run, length, start = decision, 1, time
            if state == STATIC:
                turns = decision == SLIP and length >= consecutive
            else:
                turns = decision == STATIC and length >= release and time >= self._earliest
            if turns:
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
