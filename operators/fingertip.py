"""Description of a fingertip: what detectors, sessions and pages must know about its counts."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil, isclose, sqrt
from typing import Any, Final, Self, cast

import numpy as np

from operators.batch import Times, Touch, s
from operators.checks import check_above, check_between
from operators.errors import FingertipError, InputError, ParameterError

CELL_LIMIT: Final = 128  # cells of a fingertip
NO_CELL: Final = -1  # empty position of a layout
RATE_TOLERANCE: Final = 0.1  # relative

_PAUSE: Final = 20  # mean intervals

# By `Fingertip.falls`, for errors about data of the other direction.
_DIRECTIONS: Final = {True: ", falling as pressure rises", False: ", rising with pressure", None: ""}
_PAGE: Final = "docs/how-to/any-fingertip.md"
_FIELDS: Final = {"layout", "rate_hz", "unit", "resolution", "range"}


@dataclass(frozen=True)
class Fingertip:
    """Cells, layout, rate, unit and range of a fingertip's counts.

    Counts are whole numbers of 16 bits. A sensor in another unit has a `resolution`: with ``kPa`` and 0.01,
    1234 counts are 12.34 kPa.

    Args:
        layout: Rows of cell numbers, the top row first; -1 is a position without a cell. Each cell from 0 on
            occurs once.
        rate: Samples per second, Hz.
        unit: Unit of a reading; ``count`` for a converter without calibration.
        resolution: Units per count.
        range: Raw counts at the lowest and the highest pressure; None: unknown. Counts of a TakkTile fall
            as the pressure rises.

    Raises:
        ParameterError: if a value is invalid.

    >>> TAKKTILE.cells, TAKKTILE.rate, TAKKTILE.falls
    (6, 100.0, True)
    """

    layout: tuple[tuple[int, ...], ...]
    rate: float
    unit: str = "count"
    resolution: float = 1.0
    range: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        cells = sorted(cell for row in self.layout for cell in row if cell != NO_CELL)
        if not 0 < len(cells) <= CELL_LIMIT or cells != [*range(len(cells))]:
            must_be = f"rows that name each cell from 0 on once, at most {CELL_LIMIT}"
            raise ParameterError("Fingertip", "layout", self.layout, must_be)
        check_above("Fingertip", "rate", self.rate, 0, "Hz")
        check_above("Fingertip", "resolution", self.resolution, 0)
        if not self.unit:
            raise ParameterError("Fingertip", "unit", self.unit, "a unit, such as count or kPa")
        if self.range is not None and self.range[0] == self.range[1]:
            raise ParameterError("Fingertip", "range", self.range, "two different counts")

    @property
    def cells(self) -> int:
        """Number of cells."""
        return sum(cell != NO_CELL for row in self.layout for cell in row)

    @property
    def falls(self) -> bool | None:
        """True if counts fall as the pressure rises; None: unknown."""
        return None if self.range is None else self.range[0] > self.range[1]

    def mirrored(self, *, upside_down: bool = False) -> tuple[int, ...]:
        """Return the cell at the mirror image of each cell, left to right or upside down.

        Returns:
            (cells,) every cell itself, if the layout is not symmetric.

        >>> TAKKTILE.mirrored(), TAKKTILE.mirrored(upside_down=True)
        ((2, 1, 0, 5, 4, 3), (5, 4, 3, 2, 1, 0))
        """
        image = self.layout[::-1] if upside_down else tuple(row[::-1] for row in self.layout)
        if any(len(row) != len(other) for row, other in zip(self.layout, image, strict=True)):
            return tuple(range(self.cells))
        pairs = {
            cell: other
            for row, other_row in zip(self.layout, image, strict=True)
            for cell, other in zip(row, other_row, strict=True)
        }
        cells = tuple(pairs[cell] for cell in range(self.cells))
        return tuple(range(self.cells)) if NO_CELL in cells else cells

    def describe(self) -> dict[str, Any]:
        """Return the description as JSON data, for session.json and model cards."""
        return {
            "cells": self.cells,
            "layout": [list(row) for row in self.layout],
            "rate_hz": self.rate,
            "unit": self.unit,
            "resolution": self.resolution,
            "range": None if self.range is None else list(self.range),
        }

    @classmethod
    def read(cls, content: object, where: str) -> Self:
        """Return the fingertip that `describe` described.

        Args:
            content: JSON data.
            where: Name of the file, for errors.

        Raises:
            InputError: if it is invalid.

        >>> Fingertip.read(TAKKTILE.describe(), "session.json") == TAKKTILE
        True
        """
        about: Mapping[str, Any] = cast("Any", content) if isinstance(content, dict) else {}
        if missing := _FIELDS - about.keys():
            raise InputError(where, f'has an invalid "fingertip": it has no {", ".join(sorted(missing))}')
        try:
            layout = tuple(tuple(int(cell) for cell in row) for row in about["layout"])
            ends = about["range"]
            limits = None if ends is None else (int(ends[0]), int(ends[1]))
            rate, resolution = float(about["rate_hz"]), float(about["resolution"])
            return cls(layout, rate, str(about["unit"]), resolution, limits)
        except (TypeError, ValueError, ArithmeticError, LookupError, ParameterError) as error:
            raise InputError(where, f'has an invalid "fingertip": {error}') from error

    def ratio(self, given: "Fingertip") -> float:
        """Return the span of the range of `given` relative to this one; 1 if unknown, or not in counts."""
        if self.range is None or given.range is None or self.unit != "count":
            return 1.0
        return abs((given.range[1] - given.range[0]) / (self.range[1] - self.range[0]))

    def check_fits(self, owner: str, given: "Fingertip") -> None:
        """Check that data of the fingertip `given` fits what `owner` was made for: this fingertip.

        Args:
            owner: Name of the detector or operator, for the error.
            given: Fingertip of the data.

        Raises:
            FingertipError: if cells, rate or unit differ; it names the operators that convert them.
        """
        needs, has, fix = list[str](), list[str](), list[str]()
        cells = given.cells != self.cells
        if cells:
            needs.append(f"{self.cells} cells")
            has.append(f"{given.cells} cells")
        unit, other = _scale(self), _scale(given)
        turned = None not in {self.falls, given.falls} and self.falls is not given.falls
        scaled = unit != other or turned
        if scaled:
            needs.append(unit + (_DIRECTIONS[self.falls] if turned else ""))
            has.append(other + (_DIRECTIONS[given.falls] if turned else ""))
        if cells or scaled:
            groups = "groups=..." if cells else ""
            ratio = given.resolution / self.resolution * (-1 if turned else 1)
            gain = f"gain={ratio:.15g}" if given.unit == self.unit else f"gain=..., unit={self.unit!r}"
            fix.append(f"Pool({', '.join(filter(None, (groups, gain if scaled else '')))})")
        if not isclose(given.rate, self.rate, rel_tol=RATE_TOLERANCE):
            needs.append(f"{self.rate:g} Hz")
            has.append(f"{given.rate:g} Hz")
            fix.append(f"Resample(rate={self.rate:g})")
        if fix:
            what = f"{' and '.join(fix)} in a flow {'converts' if len(fix) == 1 else 'convert'} it"
            raise FingertipError(owner, ", ".join(needs), ", ".join(has), f"{what} ({_PAGE})")


def grid(cells: int, columns: int | None = None) -> tuple[tuple[int, ...], ...]:
    """Return a layout of rows, numbered from the top left.

    Args:
        cells: Number of cells.
        columns: Cells per row; None: about as many as rows.

    Raises:
        ParameterError: if there are too few or too many cells.

    >>> grid(5)
    ((0, 1, 2), (3, 4, -1))
    """
    check_between("grid", "cells", cells, 1, CELL_LIMIT)
    wide = ceil(sqrt(cells)) if columns is None else columns
    check_between("grid", "columns", wide, 1, cells)
    rows = range(0, cells, wide)
    return tuple(tuple(i if i < cells else NO_CELL for i in range(row, row + wide)) for row in rows)


def usual_layout(cells: int) -> tuple[tuple[int, ...], ...]:
    """Return the layout that is assumed if none is stated: that of a TakkTile for six cells, else a grid."""
    return TAKKTILE.layout if cells == TAKKTILE.cells else grid(cells)


def rows_per_second(time: Times) -> float | None:
    """Return the rate of rows with times (n,) in ns, in any order: rows over time, without pauses.

    A pause is longer than 0.25 s and 20 mean intervals between times, of those that are shorter. Lost samples
    do not lower the rate if most intervals are equal: a longer one counts as several. Rounded times differ
    from lost samples in that they do not drift from a regular clock.

    Returns:
        None if all rows have the same time.

    >>> rows_per_second(np.array([0, 0, 1, 2, 2, 3]) * 1_000_000)  # whole milliseconds
    1666.6666666666667
    """
    stamps, counts = np.unique(time, return_counts=True)
    steps, rows = np.diff(stamps), counts[:-1]  # of each time until the next: ns, number of rows
    if not steps.size:
        return None
    order = np.argsort(steps)
    ordered = steps[order]
    means = np.cumsum(ordered) / np.arange(1, ordered.size + 1)
    pauses = 1 + np.flatnonzero(ordered[1:] > np.maximum(_PAUSE * means[:-1], s / 4))
    kept = np.sort(order[: next((each for each in pauses if 2 * each > ordered.size), ordered.size)])
    steps, rows = steps[kept], rows[kept]
    usual = float(np.median(steps))
    for longest in (np.inf, 2.5 * usual):  # of all rows, then without gaps
        near = steps <= longest
        mean = steps[near].sum() / rows[near].sum()
        drift = np.ptp(np.cumsum(steps[near] - mean * rows[near]))
        if drift <= 3 * usual and steps[near].sum() > steps.sum() / 2:
            return float(s / mean)
    samples = float(np.maximum(np.rint(steps / usual), 1).sum())
    equal = np.mean(np.abs(steps - usual) <= usual / 10)
    lost = equal > 2 / 3 and rows.sum() < 1.1 * rows.size and samples < 2 * rows.size
    return (samples if lost else float(rows.sum())) * s / float(steps.sum())


def measured(batch: Touch) -> Fingertip | None:
    """Return what rows of a touch stream say about their fingertip: cells, and the rate.

    Returns:
        None if all rows have the same time, which tells no rate.
    """
    rate = rows_per_second(batch.time)
    return None if rate is None else Fingertip(usual_layout(batch.cells), rate)


def _scale(fingertip: Fingertip) -> str:
    resolution, unit = fingertip.resolution, fingertip.unit
    return unit if isclose(resolution, 1) else f"steps of {resolution:g} {unit}"


TAKKTILE: Final = Fingertip(((5, 4, 3), (0, 1, 2)), 100.0, range=(1023, 0))  # x right, y up
