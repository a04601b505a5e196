"""Work units: messages that name rows of a recording, which the worker reads.

Units and results travel as lines of text: the partition, a tab, and a pickle in base64. All machines share
the storage that holds the named Parquet files, and trust it: the flow to run is on it too.
"""

import pickle
from base64 import b64decode, b64encode
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple, Self, TypeAlias, cast

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


class RecordingEnd(NamedTuple):
    """End-of-recording marker."""

    slices: int  # total number
    units: int  # number per share
    shares: tuple[tuple[int, ...], ...]  # fingertips of each share


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
        """Key of the share's state, which is also a relative path."""
        return f"{self.session}/{self.generation}/{self.share}"


@dataclass(frozen=True)
class ShareResult(_Line):
    """Result of a share: all of its units are processed, or one of them failed."""

    session: str
    folder: str
    generation: int
    share: int
    partition: int  # of the session, not of the share
    end: RecordingEnd | None  # None: a unit failed
    error: str = ""

    @property
    def key(self) -> str:
        """Key of the session's state, which is also a relative path."""
        return f"{self.session}/{self.generation}"

    @classmethod
    def of(cls, unit: WorkUnit, error: str = "") -> Self:
        """Return the result of a share whose last unit, or failed one, is `unit`."""
        end, partition = None if error else unit.end, unit.partition - unit.share
        return cls(unit.session, unit.folder, unit.generation, unit.share, partition, end, error)


def partition_of(line: str) -> int:
    """Return the partition of a line without reading the rest.

    >>> partition_of(ShareResult("one", "/data/one", 0, 3, 7, None).to_line())
    7
    """
    return int(line.partition(_TAB)[0])
