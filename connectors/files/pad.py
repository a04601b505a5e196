"""Layout and range of a fingertip as text, for `slipflow import` and recipes."""

import re
from dataclasses import dataclass
from math import isfinite, nan
from typing import Final, Self

from operators.errors import ParameterError
from operators.fingertip import CELL_LIMIT, Fingertip, grid

Layout = tuple[tuple[int, ...], ...]

_GRID: Final = re.compile(r"(\d{1,3}) *x *(\d{1,3})")  # rows x columns


@dataclass(frozen=True, slots=True)
class Pad:
    """Layout and range of a fingertip whose file states neither.

    >>> Pad.parse("2x3", "0:400")
    Pad(layout=((0, 1, 2), (3, 4, 5)), range=(0.0, 400.0))

    Args:
        layout: Rows of cell numbers, the top row first, as of a `Fingertip`; None: unknown.
        range: Readings at the lowest and at the highest pressure, in the unit of the cells; None: unknown.
    """

    layout: Layout | None = None
    range: tuple[float, float] | None = None

    @classmethod
    def parse(cls, layout: str = "", range: str = "") -> Self:  # noqa: A002 - as of a fingertip
        """Parse texts: ``8x2`` (rows x columns) or ``5,4,3/0,1,2`` (rows from the top), and ``LOW:HIGH``.

        Raises:
            ParameterError: on another text.
        """
        return cls(_layout(layout) if layout.strip() else None, _range(range) if range.strip() else None)

    def check_cells(self, owner: str, cells: int) -> None:
        """Require that the layout, if there is one, has as many cells as the counts.

        Raises:
            ParameterError: if it has not, or does not name each cell once.
        """
        if self.layout is not None and Fingertip(self.layout, 1.0).cells != cells:
            must_be = f"of {cells} cells, as many as the counts have"
            raise ParameterError(owner, "layout", layout_text(self.layout), must_be)


def layout_text(layout: Layout) -> str:
    """Return a layout as `Pad.parse` takes it.

    >>> layout_text(((5, 4, 3), (0, 1, 2)))
    '5,4,3/0,1,2'
    """
    return "/".join(",".join(map(str, row)) for row in layout)


def _layout(text: str) -> Layout:
    must_be = (
        f"ROWSxCOLUMNS such as 8x2, at most {CELL_LIMIT} cells, or cell numbers of each row from the top,"
        " such as 5,4,3/0,1,2 (-1: no cell)"
    )
    if match := _GRID.fullmatch(text.strip()):
        rows, columns = int(match[1]), int(match[2])
        if not 0 < rows * columns <= CELL_LIMIT:
            raise ParameterError("fingertip", "layout", text, must_be)
        return grid(rows * columns, columns)
    try:
        return tuple(tuple(int(cell) for cell in row.split(",")) for row in text.split("/"))
    except ValueError:
        raise ParameterError("fingertip", "layout", text, must_be) from None


def _range(text: str) -> tuple[float, float]:
    try:
        low, high = map(float, text.split(":"))
    except ValueError:
        low = high = nan
    if not isfinite(low) or not isfinite(high):
        must_be = "LOW:HIGH, the readings at the lowest and at the highest pressure, such as 0:4000"
        raise ParameterError("fingertip", "range", text, must_be)
    return low, high
