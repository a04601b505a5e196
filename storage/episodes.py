"""What was done when: the episodes that a source describes, such as one stroke of the arm over a surface."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, Self

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
        listed: dict[str, dict[str, Any]] = {}
        for source, episodes in listings(descriptions).items():
            for number, each in enumerate(episodes):
                listed[json.dumps(each, sort_keys=True)] = _row(f"source {source!r}, episode {number}", each)
        rows = sorted(listed.values(), key=lambda row: int(row["start"]))
        for number, (row, following) in enumerate(pairwise(rows)):
            if row["end"] > following["start"]:
                raise InputError("episodes", f"{number} and {number + 1} in the order of time overlap")
        try:
            table = pa.Table.from_pylist([{**row, "episode": n} for n, row in enumerate(rows)], SCHEMA)
        except (pa.ArrowException, OverflowError) as error:
            raise InputError("episodes", f"a value has the wrong type: {error}") from error
        return cls(table)

    def at(self, time: Times) -> NDArray[np.int32]:
        """The episode of each instant, NONE where there is none."""
        number = np.searchsorted(self.starts, time, side="right") - 1  # (n,) -1 before the first
        ends = np.append(self.ends, np.iinfo(np.int64).min)  # at -1 it is over, too
        return np.where(time < ends[number], number, NONE).astype(np.int32)

    @property
    def starts(self) -> Times:
        """The first instant of each, ns."""
        return self.table["start"].to_numpy()

    @property
    def ends(self) -> Times:
        """The first instant after each, ns."""
        return self.table["end"].to_numpy()


def listings(descriptions: Mapping[str, Description]) -> dict[str, list[Json]]:
    """What sources list under "episodes", as they do; a list that several of them share is given once.

    Raises:
        InputError: if one is no list.
    """
    found, known = dict[str, list[Json]](), set[int]()
    for source, description in descriptions.items():
        episodes = description.get("episodes", [])
        if not isinstance(episodes, list):
            raise InputError(f"source {source!r}", '"episodes" is not a list')
        if id(episodes) not in known:
            known.add(id(episodes))
            found[source] = episodes
    return found


def _row(where: str, episode: Json) -> dict[str, Any]:
    if isinstance(episode, dict):
        start, end = episode.get("start"), episode.get("end")
        if isinstance(start, int) and isinstance(end, int) and start < end:
            return episode
    raise InputError(where, "needs a start and a later end, in ns")
