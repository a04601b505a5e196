"""The moves of a run, as a recording tells of them."""

from array import array
from collections.abc import Sequence
from typing import SupportsIndex, overload

from connectors.sim.scene import Move
from operators.ports import Json


class Moved(Sequence[Json]):
    """Episodes, of which there may be a day's: each has 34 bytes, and is made when it is asked for.

    Another thread may read while moves are added.

    >>> moved = Moved("plane")
    >>> moved.add(Move("tap", seconds=1.0, direction_deg=90), 0, 1_000_000_000)
    >>> len(moved), moved[-1]["motion"], [each["end"] for each in moved]
    (1, 'tap', [1000000000])
    """

    def __init__(self, curvature: str) -> None:
        """Begin with none, on a surface of this curvature."""
        self._curvature = curvature
        self._names: list[str] = []  # of motions and axes, as they came
        self._columns = _Columns()

    def add(self, move: Move, start: int, end: int) -> None:
        """Add a move, with its first instant and the first after it, ns."""
        columns = self._columns
        columns.start.append(start)
        columns.end.append(end)
        columns.motion.append(self._code(move.motion))
        columns.axis.append(self._code(move.axis))
        columns.direction.append(move.direction_deg)
        columns.speed.append(move.speed)

    def clear(self) -> None:
        """Begin anew."""
        self._columns = _Columns()

    def __len__(self) -> int:
        return len(self._columns)

    @overload
    def __getitem__(self, index: SupportsIndex) -> dict[str, Json]: ...

    @overload
    def __getitem__(self, index: slice) -> list[Json]: ...

    def __getitem__(self, index: SupportsIndex | slice) -> dict[str, Json] | list[Json]:
        columns = self._columns  # the run may begin anew meanwhile
        if isinstance(index, slice):
            return [self._episode(columns, row) for row in range(len(columns))[index]]
        return self._episode(columns, range(len(columns))[index])

    def _episode(self, columns: "_Columns", row: int) -> dict[str, Json]:
        return {
            "start": columns.start[row],
            "end": columns.end[row],
            "motion": self._names[columns.motion[row]],
            "axis": self._names[columns.axis[row]],
            "direction_deg": columns.direction[row],
            "speed": columns.speed[row],
            "curvature": self._curvature,
        }

    def _code(self, name: str) -> int:
        if name not in self._names:
            self._names.append(name)
        return self._names.index(name)


class _Columns:
    """The values of all moves; the speed is added last."""

    def __init__(self) -> None:
        self.start, self.end = array("q"), array("q")  # ns
        self.motion, self.axis = array("b"), array("b")  # codes
        self.direction, self.speed = array("d"), array("d")  # deg; m/s or rad/s

    def __len__(self) -> int:
        return len(self.speed)
