"""Debouncing of slip probabilities."""

from dataclasses import dataclass

from operators.batch import SLIP, STATIC, UNKNOWN, Scores, Slips
from operators.checks import check_above, check_between, check_whole
from operators.operator import Operator
from operators.steps import Record, RowType, Steps


@dataclass
class Debounce(Operator[Scores, Slips]):
    """Convert slip probabilities to slip events: onset and end.

    A slip starts after `consecutive` decisions for slip in a row, and ends after `release` decisions against
    it. NaN is not a decision and interrupts either run. A slip that is open when the stream ends gets no end.

    Args:
        threshold: Smallest probability that is a decision for slip, above 0, at most 1.
        consecutive: Decisions that start a slip; 2 in the paper's robot tests.
        release: Decisions that end a slip.

    Raises:
        ParameterError: if a parameter is invalid.

    References:
        "Under Pressure" (2021), section V-B.

    >>> import numpy as np
    >>> scores = Scores(np.arange(5), np.array([0.9, 0.8, 0.9, 0.1, 0.2]))
    >>> slips = Debounce().push(scores)
    >>> slips.state, slips.start, slips.time
    (array([1, 0], dtype=int8), array([0, 3]), array([1, 4]))
    """

    threshold: float = 0.5
    consecutive: int = 2
    release: int = 2

    def __post_init__(self) -> None:
        check_above("Debounce", "threshold", self.threshold, 0)
        check_between("Debounce", "threshold", self.threshold, 0, 1)
        check_whole("Debounce", "consecutive", self.consecutive, 1, "decision")
        check_whole("Debounce", "release", self.release, 1, "decision")

    def steps(self, *given: RowType) -> Steps:
        """Return the step."""
        return Steps(
            settings={
                "threshold": float(self.threshold),
                "consecutive": self.consecutive,
                "release": self.release,
            },
            state={
                "decision": UNKNOWN,  # of the current run
                "length": 0,  # decisions of the run
                "start": 0,  # ns, of the run
                "slip": STATIC,  # SLIP during a slip
            },
            step=_debounce,
        )


def _debounce(settings: Record, state: Record, row: Record, out: Record) -> bool:
    value = row.probability
    decision = SLIP if value >= settings.threshold else STATIC if value < settings.threshold else UNKNOWN
    if decision == state.decision:
        state.length += 1
    else:
        state.decision, state.length, state.start = decision, 1, row.time
    if state.slip == STATIC:
        changes = decision == SLIP and state.length >= settings.consecutive
    else:
        changes = decision == STATIC and state.length >= settings.release
    if changes:
        state.slip = decision
        out.time, out.start, out.state, out.probability = row.time, state.start, decision, value
    return bool(changes)
