"""Subtraction of the baseline."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from operators.batch import Counts, Flags, Touch, Zeroed
from operators.checks import check_at_least
from operators.errors import ParameterError
from operators.operator import Operator
from operators.row_loop import nearest_count, row_loop
from operators.row_queues import Chain

_RANGE: Final = np.iinfo(np.int16)


@dataclass
class Zero(Operator[Touch, Zeroed]):
    """Subtract the baseline, the counts of the unloaded fingertip.

    Without a given baseline, it is measured as in TakkTile's own code: the median of a cell's valid counts
    in the first `scans` samples, rounded half to even. These samples are delayed until it is known. A cell
    without valid counts has no baseline and stays invalid. Differences beyond 16 bits are limited to them.
    Zeroed input passes unchanged.

    Args:
        baseline: Raw counts of each cell, or one value for all cells; None: measure.
        scans: Number of samples for the measurement.

    Raises:
        ParameterError: if the baseline is out of range or `scans` is below 1; from `push`, if a baseline
            does not have as many cells as the fingertip.

    >>> cells = np.full((1, 6), 700, np.int16)
    >>> touch = Touch(np.zeros(1, int), cells, cells, cells > 0)
    >>> Zero(baseline=710).push(touch).counts
    array([[-10, -10, -10, -10, -10, -10]], dtype=int16)
    """

    baseline: int | tuple[int, ...] | None = None
    scans: int = 100
    _offset: Counts | None = field(default=None, init=False, repr=False, compare=False)  # (1, cells)
    # (cells,) cells with a baseline; None: all
    _known: Flags | None = field(default=None, init=False, repr=False, compare=False)
    _held: Chain[Touch] = field(default_factory=lambda: Chain(Touch), init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_at_least("Zero", "scans", self.scans, 1, "sample")
        given = (self.baseline,) if isinstance(self.baseline, int) else self.baseline
        if given is not None and not (given and all(_RANGE.min <= cell <= _RANGE.max for cell in given)):
            raise self._error(f"one count, or one of each cell, from {_RANGE.min} to {_RANGE.max}")

    @property
    def _example_cells(self) -> int:
        return len(self.baseline) if isinstance(self.baseline, tuple) else super()._example_cells

    def process(self, batch: Touch) -> Zeroed:
        """Return the batch with the baseline subtracted, or delay it."""
        if isinstance(batch, Zeroed):
            return batch
        if self._offset is None and self.baseline is not None:
            self._offset = self._given(batch.counts.shape[1])
        if self._offset is not None:
            return self._subtract(batch, self._offset)
        self._held.append(batch)
        return self._release() if len(self._held) >= self.scans else Zeroed.empty()

    def flush(self) -> Zeroed:
        """Return the delayed samples, zeroed with their own baseline."""
        return self._release() if len(self._held) else Zeroed.empty()

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
        self._offset = np.where(known, np.rint(median), 0).astype(np.int16)[None]
        return self._subtract(held, self._offset)

    def _subtract(self, batch: Touch, offset: Counts) -> Zeroed:
        valid = batch.valid if self._known is None else batch.valid & self._known
        counts = np.empty(batch.counts.shape, np.int16)
        _subtract(batch.counts, offset[0], counts)
        return Zeroed(batch.time, counts, batch.temperature, valid, finger=batch.finger)


@row_loop
def _subtract(counts: Counts, /, offset: Counts, zeroed: Counts) -> None:
    """Write the differences (n, cells), limited to 16 bits: a difference that wraps would turn its sign."""
    for row in range(len(counts)):
        for cell in range(len(offset)):
            zeroed[row, cell] = nearest_count(float(counts[row, cell]) - float(offset[cell]))
