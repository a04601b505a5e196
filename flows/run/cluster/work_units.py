"""What travels through the cluster: which rows of a recording are whose turn, never the rows themselves.

A claim names rows of Parquet files on the storage that all machines share; the worker that gets it reads
them. Claims are lines, in files that the cluster reads: who it is dealt to, a tab, JSON.
"""

import json
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, Self

from operators.errors import InputError

LIMIT: Final = 4_000_000  # characters of a line
_TAB: Final = "\t"  # JSON has none


class Rows(NamedTuple):
    """Rows of one stream that lie together in one file."""

    source: str  # the name of its node in the flow
    finger: int
    path: str  # within the session's folder
    sha256: str | None  # of the file; None where no manifest lists it
    start: int  # the first, among the file's rows of that fingertip
    stop: int  # the first behind them


class Slice(NamedTuple):
    """What all streams have within one span of time, as a replay cuts them."""

    number: int
    rows: tuple[Rows, ...]  # at most one of each stream


class End(NamedTuple):
    """That a recording has no further rows."""

    slices: int  # in all
    claims: int  # of each share
    shares: tuple[tuple[int, ...], ...]  # the fingertips of each


class _Line:
    """What travels as a line of text: whose turn it is, a tab, and the fields of a dataclass as JSON."""

    deal: int

    def line(self) -> str:
        """It as one line of text."""
        return f"{self.deal}{_TAB}{json.dumps(vars(self), separators=(',', ':'))}"


@dataclass(frozen=True)
class Claim(_Line):
    """The next slices of a recording for a share of its fingertips.

    >>> claim = Claim("one", "/data/one", 0, 1, (2,), 5, 0, {"touch": (0, 1, 2)}, (Slice(0, ()),))
    >>> Claim.read(claim.line()) == claim
    True
    """

    session: str
    folder: str  # the session's
    turn: int  # counts how often the recording was cut anew
    share: int  # which of the shares of this turn
    fingers: tuple[int, ...]  # that are in it
    deal: int  # claims are dealt out to the workers in turn, by this; one more for each share
    number: int  # among the claims of the share
    sources: Mapping[str, tuple[int, ...]]  # the fingertips of each source
    slices: tuple[Slice, ...]
    end: End | None = None

    @property
    def key(self) -> str:
        """What shares one state: a path."""
        return f"{self.session}/{self.turn}/{self.share}"

    @classmethod
    def read(cls, line: str) -> Self:
        """The claim that a line tells.

        Raises:
            InputError: if it tells none.
        """
        with _reading("claim", line) as told:
            slices: list[Any] = told.pop("slices")
            fingers: list[int] = told.pop("fingers")
            sources: dict[str, list[int]] = told.pop("sources")
            return cls(
                **told,
                fingers=tuple(fingers),
                sources={name: tuple(each) for name, each in sources.items()},
                slices=tuple(Slice(number, tuple(Rows(*each) for each in rows)) for number, rows in slices),
            )


@dataclass(frozen=True)
class Done(_Line):
    """That all claims of a share are worked off, or that one of them cannot be."""

    session: str
    folder: str
    turn: int
    share: int
    deal: int  # sessions are dealt out to the workers in turn, by this
    end: End | None  # None: it failed before
    error: str = ""

    @property
    def key(self) -> str:
        """What shares one state: a path."""
        return f"{self.session}/{self.turn}"

    @classmethod
    def read(cls, line: str) -> Self:
        """What a line tells.

        Raises:
            InputError: if it does not tell that a share is done.
        """
        with _reading("done", line) as told:
            return cls(**told)


def deal_of(line: str) -> int:
    """What the line of a claim or of a `Done` is dealt out by; the rest is not read.

    >>> deal_of(Done("one", "/data/one", 0, 3, 7, None).line())
    7
    """
    return int(line.partition(_TAB)[0])


@contextmanager
def _reading(what: str, line: str) -> Generator[dict[str, Any]]:
    """The fields that a line holds, for a block that makes `what` of them; errors of both are told alike."""
    if len(line) > LIMIT:
        raise InputError(what, f"is longer than {LIMIT} characters")
    try:
        told: dict[str, Any] = json.loads(line.partition(_TAB)[2])
        told["end"] = _end(told["end"])
        yield told
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(what, f"cannot be read: {error!r} in {line[:80]!r}") from error


def _end(told: tuple[int, int, list[list[int]]] | None) -> End | None:
    return told and End(told[0], told[1], tuple(tuple(share) for share in told[2]))
