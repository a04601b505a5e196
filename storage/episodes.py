"""What was done when: the episodes that a source describes, such as one stroke of the arm over a surface."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, Protocol, Self, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from operators.batch import Times
from operators.errors import InputError
from operators.ports import Description, Json

NONE: Final = -1  # the episode of a row that belongs to none

_FIELDS: "list[pa.Field[Any]]" = [
    pa.field("episode", pa.int32(), nullable=False),
    pa.field("start", pa.int64(), nullable=False, metadata={"unit": "ns"}),
    pa.field("end", pa.int64(), nullable=False, metadata={"unit": "ns"}),  # the first instant after it
    pa.field("motion", pa.string()),  # translation, rotation, hold, tap or lift
    pa.field("axis", pa.string()),  # primary or oblique
    pa.field("direction_deg", pa.float64(), metadata={"unit": "deg"}),
    pa.field("speed", pa.float64(), metadata={"unit": "m/s"}),
    pa.field("curvature", pa.string()),  # plane, sphere, cylinder_x or cylinder_y
    pa.field("split", pa.string()),
]
SCHEMA: Final = pa.schema(_FIELDS)
TIMES: Final = ("start", "end")  # columns


class Numbering(Protocol):
    """What tells the episodes of instants."""

    def at(self, time: Times) -> NDArray[np.int32]:
        """The episode of each instant, NONE where there is none."""
        ...


@dataclass(frozen=True)
class Episodes:
    """The episodes of a session, numbered from 0 in the order of time; they do not overlap."""

    table: pa.Table  # of SCHEMA

    @classmethod
    def described(cls, descriptions: Mapping[str, Description]) -> Self:
        """Those that the sources of a run list under "episodes"; sources may list the same ones.

        Raises:
            InputError: if a value has the wrong type, or two overlap.
        """
        rows: list[dict[str, Json]] = []
        for source, listed in listings(descriptions).items():
            rows += checked(source, listed)
        rows.sort(key=start_of)
        return cls(tabled(rows))

    def at(self, time: Times) -> NDArray[np.int32]:
        """The episode of each instant, NONE where there is none."""
        return numbered(self.starts, self.ends, time)

    @property
    def starts(self) -> Times:
        """The first instant of each, ns."""
        return self.table["start"].to_numpy()

    @property
    def ends(self) -> Times:
        """The first instant after each, ns."""
        return self.table["end"].to_numpy()


def listings(descriptions: Mapping[str, Description]) -> dict[str, Sequence[Json]]:
    """What sources list under "episodes", as they do; a list that several of them share is given once.

    Raises:
        InputError: if one is no list.
    """
    found, known = dict[str, Sequence[Json]](), set[int]()
    for source, description in descriptions.items():
        episodes = description.get("episodes", [])
        if not isinstance(episodes, Sequence) or isinstance(episodes, str):
            found_type = type(episodes).__name__
            raise InputError(f"source {source!r}", f'"episodes" is not a list, but a {found_type}')
        if id(episodes) not in known:
            known.add(id(episodes))
            found[source] = episodes
    return found


def numbered(starts: Times, ends: Times, time: Times, first: int = 0) -> NDArray[np.int32]:
    """The episode of each instant, of those with these spans, the first of which has this number."""
    number = np.searchsorted(starts, time, side="right") - 1  # (n,) -1 before the first
    over = np.append(ends, np.iinfo(np.int64).min)  # at -1 it is over, too
    return np.where(time < over[number], number + first, NONE).astype(np.int32)


def checked(source: str, episodes: Sequence[Json], first: int = 0) -> list[dict[str, Json]]:
    """Episodes that a source lists, of which the first has this number in its list.

    Raises:
        InputError: if one has no start or no later end.
    """
    for number, each in enumerate(episodes, first):
        if isinstance(each, dict):
            start, end = each.get("start"), each.get("end")
            if isinstance(start, int) and isinstance(end, int) and start < end:
                continue
        reason = f"needs a start and a later end, in ns; it is {each!r:.80}"
        raise InputError(f"source {source!r}, episode {number}", reason)
    return cast("list[dict[str, Json]]", [*episodes])


def start_of(row: Mapping[str, Json]) -> int:
    """The first instant of an episode, ns."""
    return cast("int", row["start"])


def end_of(row: Mapping[str, Json]) -> int:
    """The first instant after an episode, ns."""
    return cast("int", row["end"])


def tabled(ordered: Sequence[Mapping[str, Json]]) -> pa.Table:
    """Episodes in the order of time as a table; what stands there twice is taken once.

    Raises:
        InputError: if a value has the wrong type, or two overlap.
    """
    rows = [*ordered[:1]]
    for row, following in pairwise(ordered):
        if end_of(row) <= start_of(following):
            rows.append(following)
        elif not _same(row, following):
            number = len(rows) - 1
            raise InputError("episodes", f"{number} and {number + 1} in the order of time overlap")
    try:
        columns: list[pa.Array[Any]] = [pa.array(range(len(rows)), pa.int32())]
        columns += [pa.array([row.get(each.name) for row in rows], each.type) for each in _FIELDS[1:]]
        return pa.Table.from_arrays(columns, schema=SCHEMA)
    except (pa.ArrowException, OverflowError) as error:
        raise InputError("episodes", f"a value has the wrong type: {error}") from error


def _same(row: Mapping[str, Json], other: Mapping[str, Json]) -> bool:
    """Whether two sources tell of one episode."""
    return row == other or json.dumps(row, sort_keys=True) == json.dumps(other, sort_keys=True)  # NaN, too
