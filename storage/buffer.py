"""The rows of one table that wait for their part."""

from dataclasses import dataclass, field
from itertools import groupby

from operators.batch import Batch, concat
from storage.frames import Rows


@dataclass
class Buffer:
    """The rows of a table of parts that are not committed yet."""

    kind: type[Batch]  # of all batches of this session
    start: int = 0  # number of its first row within the table
    batches: list[Batch] = field(default_factory=list[Batch])
    rows: int = 0
    first: int = 0  # ns, earliest event time
    last: int = 0  # ns, latest

    @property
    def end(self) -> int:
        """The number of the row that comes next."""
        return self.start + self.rows

    def add(self, batch: Batch) -> None:
        """Keep a batch, which has rows."""
        self.rows, self.first, self.last = self.plus(batch)
        self.batches.append(batch)

    def plus(self, batch: Batch) -> tuple[int, int, int]:
        """What rows, first and last would be with one batch more."""
        time = batch.time
        first, last = (time.item(),) * 2 if len(time) == 1 else (time.min().item(), time.max().item())
        if not self.rows:
            return len(time), first, last
        return self.rows + len(time), min(self.first, first), max(self.last, last)

    def numbered(self) -> list[Rows]:
        """Its rows, from now on in as few batches as there can be, of one fingertip each."""
        runs = groupby(self.batches, key=lambda batch: batch.finger)
        self.batches = [concat(self.kind, list(run)) for _, run in runs]
        numbered, first = list[Rows](), self.start
        for batch in self.batches:
            numbered.append(Rows(first, batch))
            first += len(batch)
        return numbered
