"""Work units: messages that name rows of a recording, which the worker reads; and their results.

Both travel as lines of text: the partition, a tab, and a pickle in base64. All machines share the storage
that holds the named Parquet files, and trust it: the flow to run is on it too.
"""

import pickle
from base64 import b64decode, b64encode
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple, Self, TypeAlias, cast

from operators.batch import Batch

_TAB: Final = "\t"


class RowRange(NamedTuple):
    """Adjacent rows of one stream in one file."""

    source: str  # name of the source node in the flow
    finger: int
    path: str  # within the session's folder
    sha256: str | None  # of the file; None if it is not in a manifest
    start: int  # first row, among the file's rows of the fingertip
    stop: int  # end of the range, exclusive


Slice: TypeAlias = tuple[
    RowRange, ...
]  # rows of a time span, as a replay cuts it; at most one range per stream
SliceResult: TypeAlias = dict[
    tuple[int, int], Batch
]  # events by the operator's index in the flow, and the fingertip


class RecordingEnd(NamedTuple):
    """End-of-recording marker."""

    slices: int  # total number
    units: int  # number per share
    shares: int  # number


class _Line:
    """Dataclass that is written as one line of text."""

    partition: int

    def to_line(self) -> str:
        """Return the line, without a line break."""
        return f"{self.partition}{_TAB}{b64encode(pickle.dumps(self)).decode()}"

    @classmethod
    def from_line(cls, line: str) -> Self:
        """Read a line that `to_line` has written."""
        return cast("Self", pickle.loads(b64decode(line.partition(_TAB)[2])))  # noqa: S301 - our own


@dataclass(frozen=True)
class WorkUnit(_Line):
    """Consecutive slices of a recording for one share of its fingertips.

    >>> unit = WorkUnit("one", "/data/one", 0, 1, (2,), 5, 0, {"touch": (0, 1, 2)}, ())
    >>> WorkUnit.from_line(unit.to_line()) == unit
    True
    """

    session: str
    folder: str  # of the session
    generation: int  # number of times that the recording was split again from its start
    share: int  # number of the share in this generation
    fingers: tuple[int, ...]  # of the share
    partition: int  # units go to worker partition % workers; consecutive for the shares of a recording
    number: int  # among the units of the share
    sources: Mapping[str, tuple[int, ...]]  # fingertips of each source
    slices: tuple[Slice, ...]
    end: RecordingEnd | None = None  # only in the last unit

    @property
    def key(self) -> str:
        """Key of the share's state."""
        return f"{self.session}/{self.generation}/{self.share}"


@dataclass(frozen=True)
class UnitResult(_Line):
    """Events that the operators gave in a work unit, or the error of its share."""

    session: str
    folder: str
    generation: int
    share: int
    number: int
    partition: int  # of the session, not of the share
    slices: tuple[SliceResult, ...] = ()  # one more at the end of the recording
    end: RecordingEnd | None = None
    error: str = ""

    @classmethod
    def of(cls, unit: WorkUnit, slices: tuple[SliceResult, ...] = (), error: str = "") -> Self:
        """Return the result of a unit; an error ends its share."""
        partition, end = unit.partition - unit.share, None if error else unit.end
        about = (unit.session, unit.folder, unit.generation, unit.share, unit.number)
        return cls(*about, partition, slices, end, error)

    @property
    def key(self) -> str:
        """Key of this result."""
        return self._key(self.share, self.number)

    def last_keys(self) -> list[str]:
        """Return the keys of the last results of all shares; empty if this is no last one."""
        return [self._key(share, self.end.units - 1) for share in range(self.end.shares)] if self.end else []

    def all_keys(self) -> list[list[str]]:
        """Return the keys of all results of the session by share; empty if this is no last one."""
        if not self.end:
            return []
        return [
            [self._key(share, number) for number in range(self.end.units)] for share in range(self.end.shares)
        ]

    def _key(self, share: int, number: int) -> str:
        return f"{self.session}/{self.generation}/{share}/{number}"


def partition_of(line: str) -> int:
    """Return the partition of a line without reading the rest.

    >>> partition_of(UnitResult("one", "/data/one", 0, 3, 0, 7).to_line())
    7
    """
    return int(line.partition(_TAB)[0])
