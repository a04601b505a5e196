"""Pooling of cells into groups."""

from dataclasses import dataclass, replace
from math import isfinite
from numbers import Real
from typing import Any, cast

import numpy as np

from operators.batch import Times, Touch, Zeroed
from operators.errors import FingertipError, ParameterError
from operators.fingertip import CELL_LIMIT, Fingertip, usual_layout
from operators.operator import Operator
from operators.steps import Record, RowType, Steps, nearest_count


@dataclass
class Pool(Operator[Touch, Touch]):
    """Pool the cells of a fingertip into groups, one output cell each, and scale their counts.

    An output cell is `gain` times the mean of its group's valid cells, rounded to the nearest count. It is
    valid if at least half of the group is. Raw input gives `Touch`; zeroed input and samples give `Zeroed`,
    without motion and labels. Pool raw touch before `Zero`.

    Args:
        groups: Cells of each group, for output cells 0, 1, ...; () keeps each cell alone.
        gain: Output counts per count; negative if counts rise with the pressure but must fall.
        unit: Unit of the output, whose range is then unknown; None: that of the input, of which a count is
            then another fraction.

    The layout is that of the input if each cell is alone, that of a TakkTile for six groups, else a grid.

    Raises:
        ParameterError: if a group is empty or names a cell twice, or the gain is 0 or not finite; from
            `push`, if a group names a cell that the fingertip does not have.

    >>> touch = Touch(np.zeros(1, int), *np.array([[[10, 20, 31]]] * 2, np.int16), np.ones((1, 3), bool))
    >>> Pool(((0,), (1, 2))).push(touch).counts
    array([[10, 26]], dtype=int16)
    """

    groups: tuple[tuple[int, ...], ...] = ()
    gain: float = 1.0
    unit: str | None = None

    def __post_init__(self) -> None:
        groups: Any = self.groups
        if not (isinstance(cast("object", self.gain), Real) and isfinite(self.gain) and self.gain != 0):
            raise ParameterError("Pool", "gain", self.gain, "a finite number, not 0")
        if not (np.iterable(groups) and all(map(_is_group, groups))):
            must_be = f"as ((0, 1), (2,)): in each group different cells from 0 to {CELL_LIMIT - 1}"
            raise ParameterError("Pool", "groups", groups, must_be)

    def output_fingertip(self, given: Fingertip) -> Fingertip:
        """Return the fingertip of the groups.

        Raises:
            FingertipError: if it has not all the cells that the groups name.
        """
        if self._needed > given.cells:
            fix = "name other cells in groups"
            raise FingertipError("Pool", f"{self._needed} cells", f"{given.cells} cells", fix)
        low, high = (nearest_count(self.gain * end) for end in given.range or (0, 0))
        return replace(
            given,
            layout=usual_layout(len(self.groups)) if self.groups else given.layout,
            unit=self.unit or given.unit,
            resolution=1.0 if self.unit else given.resolution / abs(self.gain),
            range=None if self.unit or low == high else (low, high),
        )

    def row_type(self, *given: RowType) -> RowType:
        """Return raw or zeroed touch, as the input, with a cell per group."""
        kind = Zeroed if issubclass(given[0].kind, Zeroed) else Touch
        return RowType(kind, len(self.groups) or given[0].cells)

    def steps(self, *given: RowType) -> Steps:
        """Return the step.

        Raises:
            ParameterError: if the fingertip has not all the cells that the groups name.
        """
        cells = given[0].cells
        if self._needed > cells:
            must_be = f"cells below {cells}: the fingertip has {cells} cells"
            raise ParameterError("Pool", "groups", self.groups, must_be)
        groups = self.groups or tuple((cell,) for cell in range(cells))
        return Steps(settings={"groups": _table(groups), "gain": float(self.gain)}, step=_pool)

    @property
    def _needed(self) -> int:
        """Number of cells that the input must have."""
        return max((cell + 1 for group in self.groups for cell in group), default=0)


def _is_group(group: object) -> bool:
    cells: list[object] = [*cast("Any", group)] if np.iterable(group) else []
    return 0 < len(cells) == len(set(cells)) and set(cells) <= {*range(CELL_LIMIT)}


def _table(groups: tuple[tuple[int, ...], ...]) -> Times:
    """Return the cells of each group, filled up with -1; (groups, widest)."""
    cells = np.full((len(groups), max(map(len, groups), default=0)), -1)
    for row, group in zip(cells, groups, strict=True):
        row[: len(group)] = group
    return cells


def _pool(settings: Record, state: Record, row: Record, out: Record) -> bool:
    out.time = row.time
    for number in range(len(settings.groups)):
        size = seen = 0
        total = heat = 0.0
        for cell in settings.groups[number]:
            if cell >= 0:
                size += 1
                if row.valid[cell]:
                    seen += 1
                    total += float(row.counts[cell])
                    heat += float(row.temperature[cell])
        out.valid[number] = seen > 0 and 2 * seen >= size
        out.counts[number] = nearest_count(settings.gain * total / max(seen, 1))
        out.temperature[number] = nearest_count(heat / max(seen, 1))
    return True
