"""Work units: messages that name rows of a recording, which the worker reads.

Units and results travel as lines of text: the partition, a tab, and JSON. All machines share the storage that
holds the named Parquet files.
"""

import json
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, Self

from operators.errors import InputError

LIMIT: Final = 4_000_000  # characters of a line
_TAB: Final = "\t"  # never occurs in JSON


class RowRange(NamedTuple):
    """Adjacent rows of one stream in one file."""

    source: str  # name of the source node in the flow
    finger: int
    path: str  # within the session's folder
    sha256: str | None  # of the file; None if it is not in a manifest
    start: int  # first row, among the file's rows of the fingertip
    stop: int  # end of the range, exclusive


class Slice(NamedTuple):
    """Rows of all streams within one time span, as a replay cuts them."""

    number: int
    rows: tuple[RowRange, ...]  # at most one per stream


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
        return f"{self.partition}{_TAB}{json.dumps(vars(self), separators=(',', ':'))}"


@dataclass(frozen=True)
class WorkUnit(_Line):
    """Consecutive slices of a recording for one share of its fingertips.

    >>> unit = WorkUnit("one", "/data/one", 0, 1, (2,), 5, 0, {"touch": (0, 1, 2)}, (Slice(0, ()),))
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

    @classmethod
    def from_line(cls, line: str) -> Self:
        """Read a unit.

        Raises:
            InputError: if the line is not a work unit.
        """
        with _parsed("work unit", line) as fields:
            slices: list[Any] = fields.pop("slices")
            fingers: list[int] = fields.pop("fingers")
            sources: dict[str, list[int]] = fields.pop("sources")
            return cls(
                **fields,
                fingers=tuple(fingers),
                sources={name: tuple(each) for name, each in sources.items()},
                slices=tuple(
                    Slice(number, tuple(RowRange(*each) for each in rows)) for number, rows in slices
                ),
            )


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

    @classmethod
    def from_line(cls, line: str) -> Self:
        """Read a result.

        Raises:
            InputError: if the line is not a result.
        """
        with _parsed("result", line) as fields:
            return cls(**fields)


def partition_of(line: str) -> int:
    """Return the partition of a line without reading the rest.

    >>> partition_of(ShareResult("one", "/data/one", 0, 3, 7, None).to_line())
    7
    """
    return int(line.partition(_TAB)[0])


@contextmanager
def _parsed(kind: str, line: str) -> Generator[dict[str, Any]]:
    """Yield the fields of a line; errors in the block count as errors of the line."""
    if len(line) > LIMIT:
        raise InputError(kind, f"is longer than {LIMIT} characters")
    try:
        fields: dict[str, Any] = json.loads(line.partition(_TAB)[2])
        if end := fields["end"]:
            fields["end"] = RecordingEnd(end[0], end[1], tuple(tuple(share) for share in end[2]))
        yield fields
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(kind, f"cannot be read: {error!r} in {line[:80]!r}") from error
