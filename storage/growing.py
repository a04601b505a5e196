"""The rows of a table of one file, which gather until the session ends."""

from itertools import pairwise

import numpy as np

from operators.batch import Batch, columns
from storage.frames import Rows


class Growing:
    """Rows in as many bytes as their columns have, an eighth more at most: 27 for a slip.

    >>> from operators.batch import Slips
    >>> rows = Growing(Slips)
    >>> for finger in (0, 0, 1):
    ...     one = np.array([7])
    ...     rows.add(Slips(one, one.astype(np.int8), one, one / 8, finger=finger))
    >>> [(first, batch.finger, len(batch)) for first, batch in rows.numbered()]
    [(0, 0, 2), (2, 1, 1)]
    """

    def __init__(self, kind: type[Batch], start: int = 0) -> None:
        """Begin with none.

        Args:
            kind: Of all batches of this session.
            start: The number of the first row within the table.
        """
        self.kind, self.start, self.rows = kind, start, 0
        self._columns = {name: bytearray() for name in columns(kind)}
        self._fingers = bytearray()

    @property
    def end(self) -> int:
        """The number of the row that comes next."""
        return self.start + self.rows

    def add(self, batch: Batch) -> None:
        """Keep the rows of a batch."""
        for name, values in self._columns.items():
            values.extend(getattr(batch, name).tobytes())
        self._fingers += np.full(len(batch), batch.finger, np.int16).tobytes()
        self.rows += len(batch)

    @property
    def batches(self) -> list[Batch]:
        """The rows as they came, in as few batches as there can be, of one fingertip each."""
        return [batch for _, batch in self.numbered()]

    def numbered(self) -> list[Rows]:
        """The same, with the number of the first row of each."""
        fingers = np.frombuffer(bytes(self._fingers), np.int16)  # (n,)
        values = [
            np.frombuffer(bytes(self._columns[name]), each.dtype).reshape(self.rows, *each.shape)
            for name, each in columns(self.kind).items()
        ]
        changes = np.flatnonzero(np.diff(fingers)) + 1
        edges: list[int] = [0, *changes.tolist(), self.rows] if self.rows else []
        return [
            Rows(
                self.start + first,
                self.kind(*(value[first:end] for value in values), finger=int(fingers[first])),
            )
            for first, end in pairwise(edges)
        ]
