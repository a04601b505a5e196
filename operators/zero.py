"""Subtraction of the baseline, and removal of single wrong readings."""

from dataclasses import dataclass
from math import inf
from typing import Final

import numpy as np

from operators.batch import Touch, Zeroed
from operators.checks import check_at_least, check_whole
from operators.errors import ParameterError
from operators.operator import Operator
from operators.spikes import NO_CELL, find_spike, forget, is_suspicious
from operators.steps import Record, RowType, Steps, copy, nearest_count

_ROOM: Final = 128  # rows that wait, at least
_RANGE: Final = np.iinfo(np.int16)


@dataclass
class Zero(Operator[Touch, Zeroed]):
    """Subtract the baseline, the counts of the unloaded fingertip.

    Without a given baseline, it is measured as in TakkTile's own code: the median of a cell's valid counts
    in the first `scans` samples, rounded half to even. These samples are delayed until it is known. A cell
    without valid counts has no baseline and stays invalid. Differences beyond 16 bits are limited to them.
    Zeroed input keeps its counts.

    A reading that differs from both neighbours in time while the other cells do not, as after a wrong bit
    on the bus, becomes invalid (`operators.spikes`). A row with such a reading is delayed until the next one.

    Args:
        baseline: Raw counts of each cell, or one value for all cells; None: measure.
        scans: Number of samples for the measurement.
        spike: Largest difference that is never tested, counts; infinite: test nothing.

    Raises:
        ParameterError: if the baseline is out of range, `scans` is below 1 or `spike` below 0; from `push`,
            if a baseline does not have as many cells as the fingertip.

    >>> cells = np.full((1, 6), 700, np.int16)
    >>> touch = Touch(np.zeros(1, int), cells, cells, cells > 0)
    >>> Zero(baseline=710).push(touch).counts
    array([[-10, -10, -10, -10, -10, -10]], dtype=int16)
    """

    baseline: int | tuple[int, ...] | None = None
    scans: int = 100
    spike: float = 4.0

    def __post_init__(self) -> None:
        check_whole("Zero", "scans", self.scans, 1, "sample")
        check_at_least("Zero", "spike", self.spike, 0, "counts")
        given = [0] if self.baseline is None else np.ravel(self.baseline).tolist()
        if not (given and all(isinstance(c, int) and _RANGE.min <= c <= _RANGE.max for c in given)):
            must_be = f"one whole count, or one of each cell, from {_RANGE.min} to {_RANGE.max}"
            raise ParameterError("Zero", "baseline", self.baseline, must_be)

    def row_type(self, *given: RowType) -> RowType:
        """Return the input type if it is zeroed, else that of zeroed touch."""
        return given[0] if issubclass(given[0].kind, Zeroed) else RowType(Zeroed, given[0].cells)

    def steps(self, *given: RowType) -> Steps:
        """Return the functions that measure the baseline, subtract it and look for wrong readings.

        Raises:
            ParameterError: if the baseline has another number of cells.
        """
        cells, zeroed = given[0].cells, issubclass(given[0].kind, Zeroed)
        measures = self.baseline is None and not zeroed
        offset = np.zeros(cells, np.int16)
        if self.baseline is not None and not zeroed:
            values = np.array(self.baseline, np.int16).ravel()
            if values.size not in {1, cells}:
                must_be = f"one count, or {cells}, one for each cell, not {values.size}"
                raise ParameterError("Zero", "baseline", self.baseline, must_be)
            offset[:] = values
        room = 1 << max(self.scans, _ROOM - 1).bit_length()  # the same for most parameters: compiled once
        return Steps(
            settings={"scans": self.scans, "spike": float(self.spike)},
            state={
                "held": np.zeros(room, given[0].packed),  # rows that wait for the baseline or the next row
                "first": 0,  # number of the oldest row that waits
                "last": 0,  # number after the newest one
                "measured": int(not measures),
                "offset": offset,
                "known": np.ones(cells, np.bool_),  # cells with a baseline
                "sorted": np.zeros(room, np.int16),  # readings of a cell
                "spikes": forget(cells),  # of `find_spike`
                "tested": 0,  # number of the next row that the test takes
                "ended": 0,
            },
            takes=(_take,),
            give=_give,
            held=room,
        )


def _take(settings: Record, state: Record, row: Record) -> None:
    copy(state.held[state.last % len(state.held)], row)
    state.last += 1


def _give(settings: Record, state: Record, out: Record) -> bool:
    """Give the oldest row that waits, if the baseline is known and no later row may show a wrong reading."""
    if not state.measured:
        if state.first == state.last or (state.last < settings.scans and not state.ended):
            return False
        for cell in range(len(state.offset)):
            _measure(state, cell, min(state.last, settings.scans))
        state.measured = 1
    room = len(state.held)
    while state.tested < state.last:
        row = state.held[state.tested % room]
        if settings.spike < inf:
            spike = find_spike(row.counts, row.valid, settings.spike, state.spikes)
            if spike != NO_CELL:
                state.held[(state.tested - 1) % room].valid[spike] = 0
        state.tested += 1
    waits = is_suspicious(state.spikes) and not state.ended
    if state.first >= state.last - int(waits):
        return False
    row = state.held[state.first % room]
    copy(out, row)
    for cell in range(len(state.offset)):
        # limited to 16 bits: a difference that wraps would turn its sign
        out.counts[cell] = nearest_count(float(row.counts[cell]) - float(state.offset[cell]))
        out.valid[cell] = row.valid[cell] and state.known[cell]
    state.first += 1
    return True


def _measure(state: Record, cell: int, scans: int) -> None:
    """Set the baseline of a cell: the median of its valid counts in the first rows, rounded half to even."""
    ordered, number = state.sorted, 0
    for scan in range(scans):
        row = state.held[scan]
        if row.valid[cell]:
            place = number
            while place > 0 and ordered[place - 1] > row.counts[cell]:
                ordered[place] = ordered[place - 1]
                place -= 1
            ordered[place] = row.counts[cell]
            number += 1
    state.known[cell] = number > 0
    if number > 0:
        state.offset[cell] = round((float(ordered[(number - 1) // 2]) + float(ordered[number // 2])) / 2)
