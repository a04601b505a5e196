"""Conversion of the rate of a touch stream."""

from dataclasses import dataclass, replace

import numpy as np

from operators.batch import Touch, Zeroed, ms, s
from operators.checks import check_above, check_between
from operators.fingertip import Fingertip
from operators.operator import Operator
from operators.steps import Record, RowType, Steps, copy, nearest_count

_SLOWEST, _FASTEST = 1e-6, 1e6  # Hz
_MOST = 1_000_000  # rows that one input row may complete


@dataclass
class Resample(Operator[Touch, Touch]):
    """Convert touch to a constant rate: each output row is the mean of the input over the period before it.

    Between two input rows the signal is a straight line. The mean over a period (a moving average)
    suppresses frequencies that would alias at the new rate; the same rule increases a rate.
    Output times are multiples of the period since 1970, whatever the start. A row follows as soon as an input
    row at or after its time arrives.

    A line ends at a row in which the cell is invalid, and at a gap. A cell is valid if lines cover at least
    half of the period; a period of which the input covers less than half gives no row. Temperatures are those
    of the newest input row. Raw input gives `Touch`; zeroed input and samples give `Zeroed`, without motion
    and labels.

    Args:
        rate: Rows per second, Hz.
        gap: Longest distance between input rows that a line bridges, ns.

    Raises:
        ParameterError: if the rate is not from 1 uHz to 1 MHz, or the gap is not above 0 and at most
            1,000,000 periods.

    >>> time = np.arange(0, 41) * ms
    >>> ramp = np.arange(0, 41, dtype=np.int16)[:, None]
    >>> slow = Resample(rate=100).push(Touch(time, ramp, 0 * ramp, ramp >= 0))
    >>> slow.time // ms, slow.counts.ravel()
    (array([10, 20, 30, 40]), array([ 5, 15, 25, 35], dtype=int16))
    """

    rate: float = 100.0
    gap: int = 200 * ms

    def __post_init__(self) -> None:
        check_between("Resample", "rate", self.rate, _SLOWEST, _FASTEST, unit="Hz")
        check_above("Resample", "gap", self.gap, 0, "ns")
        longest = round(_MOST * s / self.rate)
        check_between("Resample", "gap", self.gap, 0, longest, unit=f"ns, {_MOST} rows")

    def output_fingertip(self, given: Fingertip) -> Fingertip:
        """Return the fingertip at the new rate."""
        return replace(given, rate=float(self.rate))

    def row_type(self, *given: RowType) -> RowType:
        """Return raw or zeroed touch, as the input."""
        return RowType(Zeroed if issubclass(given[0].kind, Zeroed) else Touch, given[0].cells)

    def steps(self, *given: RowType) -> Steps:
        """Return the functions that take a row and give those whose periods end up to it."""
        cells, period = given[0].cells, round(s / self.rate)
        return Steps(
            settings={"period": period, "gap": self.gap},
            state={
                "row": np.zeros((), given[0].packed),  # newest
                "done": 1,  # the newest row was processed
                "newest": -self.gap - 1,  # ns, time up to which the signal was processed
                "due": 0,  # ns, next output row
                "covered": 0,  # ns of the current period that the input covers
                "value": np.zeros(cells),  # counts at `newest`
                "area": np.zeros(cells),  # counts * ns of the current period
                "span": np.zeros(cells),  # ns of the current period
                "whole": np.zeros(cells, np.bool_),  # the newest row is valid
            },
            takes=(_take,),
            give=_give,
            factor=self.gap // period + 2,
        )


def _take(settings: Record, state: Record, row: Record) -> None:
    copy(state.row, row)
    state.done = 0
    if row.time - state.newest > settings.gap:  # no line: drop the period
        state.newest, state.covered = row.time, 0
        state.due = (row.time // settings.period + 1) * settings.period  # first multiple after the row
        state.area[:] = 0.0
        state.span[:] = 0.0
        state.whole[:] = 0


def _give(settings: Record, state: Record, out: Record) -> bool:
    row = state.row
    while state.newest < row.time:
        start, until = state.newest, min(row.time, state.due)
        share = (until - start) / (row.time - start)
        for cell in range(len(row.counts)):
            if state.whole[cell] and row.valid[cell]:
                before = state.value[cell]
                value = before + (float(row.counts[cell]) - before) * share
                state.area[cell] += (before + value) * 0.5 * (until - start)
                state.span[cell] += until - start
                state.value[cell] = value
        state.newest = until
        state.covered += until - start
        if until == state.due:
            gives = 2 * state.covered >= settings.period
            if gives:
                _write(settings, state, out)
            state.due, state.covered = until + settings.period, 0
            state.area[:] = 0.0
            state.span[:] = 0.0
            if gives:
                return True
    if not state.done:
        state.done = 1
        for cell in range(len(row.counts)):
            state.value[cell], state.whole[cell] = float(row.counts[cell]), row.valid[cell]
    return False


def _write(settings: Record, state: Record, out: Record) -> None:
    """Write the means of the period that ends."""
    out.time = state.newest
    for cell in range(len(state.area)):
        span = state.span[cell]
        out.counts[cell] = nearest_count(state.area[cell] / span if span > 0.0 else 0.0)
        out.valid[cell] = 2.0 * span >= settings.period
        out.temperature[cell] = state.row.temperature[cell]
