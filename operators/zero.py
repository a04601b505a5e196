"""Subtraction of the baseline, and removal of single wrong readings."""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from operators.batch import Counts, Flags, Reals, Times, Touch, Zeroed, concat
from operators.checks import check_at_least
from operators.errors import ParameterError
from operators.operator import Operator
from operators.row_loop import nearest_count, row_loop
from operators.row_queues import Chain
from operators.spikes import NO_CELL, find_spike, forget, is_suspicious

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
    _offset: Counts | None = field(default=None, init=False, repr=False, compare=False)  # (1, cells)
    # (cells,) cells with a baseline; None: all
    _known: Flags | None = field(default=None, init=False, repr=False, compare=False)
    _held: Chain[Touch] = field(default_factory=lambda: Chain(Touch), init=False, repr=False, compare=False)
    # of `find_spike`
    _state: Reals = field(default_factory=lambda: forget(0), init=False, repr=False, compare=False)
    _suspicious: Zeroed | None = field(default=None, init=False, repr=False, compare=False)  # the latest row

    def __post_init__(self) -> None:
        check_at_least("Zero", "scans", self.scans, 1, "sample")
        check_at_least("Zero", "spike", self.spike, 0, "counts")
        given = (self.baseline,) if isinstance(self.baseline, int) else self.baseline
        if given is not None and not (given and all(_RANGE.min <= cell <= _RANGE.max for cell in given)):
            raise self._error(f"one count, or one of each cell, from {_RANGE.min} to {_RANGE.max}")

    @property
    def _example_cells(self) -> int:
        return len(self.baseline) if isinstance(self.baseline, tuple) else super()._example_cells

    def process(self, batch: Touch) -> Zeroed:
        """Return the batch with the baseline subtracted, or delay it."""
        if self._offset is None and isinstance(batch, Zeroed):
            self._use(np.zeros((1, batch.cells), np.int16))
        elif self._offset is None and self.baseline is not None:
            self._use(self._given(batch.cells))
        if self._offset is not None:
            return self._subtract(batch, self._offset)
        self._held.append(batch)
        return self._release() if len(self._held) >= self.scans else Zeroed.empty()

    def flush(self) -> Zeroed:
        """Return the delayed samples, zeroed with their own baseline."""
        released = self._release() if len(self._held) else Zeroed.empty()
        last, self._suspicious = self._suspicious, None
        return released if last is None else concat(type(last), [released, last])

    def _use(self, offset: Counts) -> None:
        self._offset, self._state = offset, forget(offset.size)

    def _given(self, cells: int) -> Counts:
        """Return the given baseline for a fingertip with this number of cells, (1, cells)."""
        offset = np.array(self.baseline, np.int16).reshape(1, -1)
        if offset.size not in {1, cells}:
            raise self._error(f"one count, or {cells}: the fingertip has {cells} cells")
        return np.repeat(offset, cells // offset.size, axis=1)

    def _error(self, expected: str) -> ParameterError:
        return ParameterError("Zero", "baseline", self.baseline, expected)

    def _release(self) -> Zeroed:
        held = self._held.take()
        first = held[: self.scans]
        number = first.valid.sum(axis=0)  # (cells,) valid readings
        known, cells = number > 0, np.arange(len(number))
        ordered = np.sort(np.where(first.valid, first.counts, _RANGE.max), axis=0)  # the valid ones first
        median = np.mean([ordered[(number - 1) // 2, cells], ordered[number // 2, cells]], axis=0)
        self._known = None if np.all(known) else known
        offset = np.where(known, np.rint(median), 0).astype(np.int16)[None]
        self._use(offset)
        return self._subtract(held, offset)

    def _subtract(self, batch: Touch, offset: Counts) -> Zeroed:
        size = batch.time.size
        counts, spikes = np.empty(batch.counts.shape, np.int16), np.empty(size, np.int64)
        found = _subtract(
            batch.counts, batch.valid, offset[0], counts, float(self.spike), self._state, spikes
        )
        if isinstance(batch, Zeroed):
            zeroed = batch
        else:
            valid = batch.valid if self._known is None else batch.valid & self._known
            zeroed = Zeroed(batch.time, counts, batch.temperature, valid, finger=batch.finger)
        return self._without_spikes(zeroed, spikes) if found else zeroed

    def _without_spikes(self, batch: Zeroed, spikes: Times) -> Zeroed:
        """Return the rows with spikes invalid, from the suspicious one on; delay the last one if it is."""
        cells = np.append(spikes, NO_CELL)  # the cell of the spike in the row before, and in each row
        if self._suspicious is None:
            cells = cells[1:]
        else:
            batch = concat(type(batch), [self._suspicious, batch])
        rows = np.flatnonzero(cells != NO_CELL)
        if len(rows):
            valid = batch.valid.copy()
            valid[rows, cells[rows]] = False
            batch = replace(batch, valid=valid)
        waits = is_suspicious(self._state)
        self._suspicious = batch[-1:] if waits else None
        return batch[:-1] if waits else batch


@row_loop
def _subtract(
    counts: Counts,
    valid: Flags,
    /,
    offset: Counts,
    zeroed: Counts,
    least: float,
    state: Reals,
    spikes: Times,
) -> bool:
    """Write the differences (n, cells), limited to 16 bits: a difference that wraps would turn its sign.

    Write the cell of which the row before was a spike to `spikes` (n,), or `NO_CELL`; return whether any is,
    or a row was or is suspicious.
    """
    found = state[-1, 0] != NO_CELL
    for row in range(len(counts)):
        for cell in range(len(offset)):
            zeroed[row, cell] = nearest_count(float(counts[row, cell]) - float(offset[cell]))
        spikes[row] = find_spike(counts[row], valid[row], least, state)
        found = found or spikes[row] != NO_CELL
    return bool(found or state[-1, 0] != NO_CELL)
