"""Work units: messages that name rows of a recording, which the worker reads; and their results.

Both travel as lines of text: the number of the receiver, a tab, and a pickle in base64. All machines share
the storage that holds the named Parquet files, and trust it: the flow to run is on it too.
"""

import pickle
from abc import ABC, abstractmethod
from base64 import b64decode, b64encode
from collections.abc import Mapping
from dataclasses import dataclass, replace
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


# rows of a time span, as a replay cuts it; at most one range per stream
Slice: TypeAlias = tuple[RowRange, ...]
# events by the operator's index in the flow, and the fingertip
SliceResult: TypeAlias = dict[tuple[int, int], Batch]


class RecordingEnd(NamedTuple):
    """End-of-recording marker."""

    slices: int  # total number
    units: int  # number per share
    shares: int  # number


class _Line(ABC):
    """Dataclass that is written as one line of text."""

    @property
    @abstractmethod
    def receiver(self) -> int:
        """Number of the worker that gets it, modulo the number of workers."""

    def to_line(self) -> str:
        """Return the line, without a line break."""
        return f"{self.receiver}{_TAB}{b64encode(pickle.dumps(self)).decode()}"

    @classmethod
    def from_line(cls, line: str) -> Self:
        """Read a line that `to_line` has written."""
        return cast("Self", pickle.loads(b64decode(line.partition(_TAB)[2])))  # noqa: S301 - our own


@dataclass(frozen=True)
class WorkUnit(_Line):
    """Consecutive slices of a recording for one share of its fingertips.

    >>> unit = WorkUnit("one", "/data/one", 4, 0, 1, (2,), 0, {"touch": (0, 1, 2)}, ())
    >>> WorkUnit.from_line(unit.to_line()) == unit
    True
    """

    session: str
    folder: str  # of the session
    recording: int  # number of the recording; recordings and shares are assigned to the workers in turn
    generation: int  # number of times that the recording was split again from its start
    share: int  # number of the share in this generation
    fingers: tuple[int, ...]  # of the share
    number: int  # among the units of the share
    sources: Mapping[str, tuple[int, ...]]  # fingertips of each source
    slices: tuple[Slice, ...]
    end: RecordingEnd | None = None  # only in the last unit

    @property
    def receiver(self) -> int:
        """Number of the worker that processes the share."""
        return self.recording + self.share

    @property
    def key(self) -> str:
        """Key of the share's state."""
        return f"{self.session}/{self.generation}/{self.share}"


@dataclass(frozen=True)
class UnitResult(_Line):
    """Events that the operators gave in a work unit, or the error that ends its share."""

    unit: WorkUnit  # without slices
    slices: tuple[SliceResult, ...] = ()  # one more at the end of the recording
    error: str = ""

    @classmethod
    def of(cls, unit: WorkUnit, slices: tuple[SliceResult, ...] = (), error: str = "") -> Self:
        """Return the result of a unit."""
        return cls(replace(unit, slices=()), slices, error)

    @property
    def receiver(self) -> int:
        """Number of the worker that writes the session."""
        return self.unit.recording

    @property
    def key(self) -> str:
        """Key of the result."""
        return f"{self.unit.key}/{self.unit.number}"

    def all_keys(self) -> list[list[str]]:
        """Return the keys of all results of the session by share; empty before the end of the share."""
        if self.unit.end is None:
            return []
        shares = (replace(self.unit, share=share).key for share in range(self.unit.end.shares))
        return [[f"{share}/{number}" for number in range(self.unit.end.units)] for share in shares]


def receiver_of(line: str) -> int:
    """Return the receiver of a line without reading the rest.

    >>> receiver_of(WorkUnit("one", "/data/one", 4, 0, 1, (2,), 0, {}, ()).to_line())
    5
    """
    return int(line.partition(_TAB)[0])
