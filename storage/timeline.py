"""When each episode of a session began and ended, while the session goes on."""

from array import array
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from operators.batch import Times
from operators.ports import Description, Json
from storage.episodes import Episodes, checked, end_of, numbered, start_of, tabled
from storage.following import Following
from storage.frames import Change


class Timeline:
    """The spans of the episodes that sources describe, in the order of time.

    To look again costs what is new, where one source lists episodes in the order of time, as a rig or a
    collection does; else all are put together anew when one has changed.
    """

    def __init__(self, describe: Mapping[str, Description]) -> None:
        """Begin with none: `look` comes first."""
        self._describe, self._following = describe, Following(describe)
        self._starts, self._ends = array("q"), array("q")  # ns
        self._source: str | None = None  # whose list the spans are, one for one; None: they are of several

    def look(self) -> bool:
        """Take in what sources describe by now; give whether anything has changed.

        Raises:
            InputError: if a value has the wrong type, or two overlap; it stays as it was.
        """
        changes = self._following.look()
        if changes and not self._extended(changes):
            whole = Episodes.described(self._describe)
            self._starts, self._ends = array("q", whole.starts.tolist()), array("q", whole.ends.tolist())
            self._source = None
        self._following.took(changes)
        return bool(changes)

    def at(self, time: Times) -> NDArray[np.int32]:
        """The episode of each instant, NONE where there is none; costs what lies behind the earliest."""
        first = max(bisect_right(self._starts, int(time.min(initial=2**63 - 1))) - 1, 0)
        return numbered(np.array(self._starts[first:]), np.array(self._ends[first:]), time, first)

    def _extended(self, changes: Sequence[Change]) -> bool:
        """Whether the changes are those of the one list, at its end, and were taken in."""
        change = changes[0]
        if len(changes) > 1 or (self._starts and change.source != self._source):
            return False
        rows = checked(change.source, change.episodes, change.first)
        if not _follow(rows, self._ends[change.first - 1] if change.first else None):
            return False
        new = Episodes(tabled(rows))  # the other values have the right types, too
        del self._starts[change.first :], self._ends[change.first :]
        self._starts.extend(new.starts.tolist())
        self._ends.extend(new.ends.tolist())
        self._source = change.source
        return True


def _follow(rows: Sequence[Mapping[str, Json]], end: int | None) -> bool:
    """Whether each begins when the one before is over, and the first at `end` (ns) at the earliest."""
    in_order = all(end_of(row) <= start_of(following) for row, following in pairwise(rows))
    return in_order and (end is None or not rows or end <= start_of(rows[0]))
