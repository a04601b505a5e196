"""Rows of one table that are not yet written to a part."""

from itertools import pairwise
from sys import byteorder

import numpy as np

from operators.batch import Batch, columns
from storage.journal import NumberedRows


class Buffer:
    """Rows in packed columns: 51 bytes per slip event, and at most an eighth more of spare capacity.

    Attributes:
        kind: Type of all batches of this session.
        cells: Number of cells of their fingertip; 0 if they have no column per cell.
        start: Number of the first row within the table.
        rows: Number of rows.
        first: Earliest event time, ns.
        last: Latest event time, ns.

    >>> from operators.batch import Slips
    >>> buffer = Buffer(Slips)
    >>> for finger in (0, 0, 1):
    ...     one = np.array([7])
    ...     buffer.add(Slips(one, one.astype(np.int8), one, one / 8, finger=finger))
    >>> [(first, batch.finger, len(batch)) for first, batch in buffer.numbered()]
    [(0, 0, 2), (2, 1, 1)]
    """

    def __init__(self, kind: type[Batch], start: int = 0, cells: int = 0) -> None:
        self.kind, self.start, self.cells = kind, start, cells
        self.rows = self.first = self.last = 0
        self._columns = {name: bytearray() for name in columns(kind)}
        self._fingers = bytearray()

    @property
    def end(self) -> int:
        """Number of the next row."""
        return self.start + self.rows

    def add(self, batch: Batch) -> None:
        """Add the rows of a batch that is not empty."""
        self.rows, self.first, self.last = self.extent_with(batch)
        for name, values in self._columns.items():
            values.extend(getattr(batch, name).tobytes())
        self._fingers += batch.finger.to_bytes(2, byteorder, signed=True) * len(batch)

    def extent_with(self, batch: Batch) -> tuple[int, int, int]:
        """Return the row count, first and last time if `batch` were added."""
        time = batch.time
        first, last = (time.item(),) * 2 if len(time) == 1 else (time.min().item(), time.max().item())
        if not self.rows:
            return len(time), first, last
        return self.rows + len(time), min(self.first, first), max(self.last, last)

    def batches(self) -> list[Batch]:
        """Return the rows in order of arrival, consecutive rows of a fingertip as one batch."""
        fingers = np.frombuffer(bytes(self._fingers), np.int16)  # (n,)
        values = [
            np.frombuffer(bytes(self._columns[name]), each.dtype).reshape(self.rows, *each.sizes(self.cells))
            for name, each in columns(self.kind).items()
        ]
        changes = np.flatnonzero(np.diff(fingers)) + 1
        edges: list[int] = [0, *changes.tolist(), self.rows] if self.rows else []
        return [
            self.kind(*(value[first:end] for value in values), finger=int(fingers[first]))
            for first, end in pairwise(edges)
        ]

    def numbered(self) -> list[NumberedRows]:
        """Return the same batches, each with the number of its first row."""
        numbered, first = list[NumberedRows](), self.start
        for batch in self.batches():
            numbered.append(NumberedRows(first, batch))
            first += len(batch)
        return numbered
