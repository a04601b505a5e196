"""Tables of a report: values are kept as numbers and formatted on output."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, Final, TypeAlias

Value: TypeAlias = str | float | int | None  # None, NaN and infinity: unknown
UNKNOWN: Final = "-"  # unknown values in tables
INTERVAL: Final = "95 %"  # head of a column with the intervals of the column before it
_LARGE: Final = 999.5  # numbers from here on have no exponent


@dataclass(frozen=True, slots=True)
class Table:
    """Rows below a head; text columns and the first column are aligned left, numbers right.

    Floats have one decimal, or those in `decimals` for their column; None there: three significant digits.

    >>> table = Table(["method", "F1", "how"], [["psd", 57.52, "late"], ["tcn", 9.0, None]])
    >>> print(table.markdown())
    | method |   F1 | how  |
    | ------ | ---: | ---- |
    | psd    | 57.5 | late |
    | tcn    |  9.0 | -    |
    >>> table.json()["rows"][1]
    {'method': 'tcn', 'F1': 9.0, 'how': None}
    """

    head: Sequence[str]
    rows: Sequence[Sequence[Value]]
    caption: str = ""
    decimals: Mapping[str, int | None] = field(default_factory=dict[str, int | None])  # by column

    def markdown(self) -> str:
        """Return a padded Markdown table, which also reads as plain text, without empty columns."""
        columns = list[list[str]]()
        for number, name in enumerate(self.head):
            cells = [row[number] for row in self.rows]
            texts = [show(cell, self.decimals.get(name, 1)) for cell in cells]
            if number and all(text == UNKNOWN for text in texts):
                continue
            column = [text.replace("|", r"\|") for text in (name, *texts)]
            width, left = max(3, *map(len, column)), not number or _is_text(cells)
            column.insert(1, "-" * width if left else "-" * (width - 1) + ":")
            columns.append([text.ljust(width) if left else text.rjust(width) for text in column])
        table = "\n".join(f"| {' | '.join(line)} |" for line in zip(*columns, strict=True))
        return f"{self.caption}\n\n{table}" if self.caption else table

    def json(self) -> dict[str, Any]:
        """Return the table as JSON data; unknown values are null. An interval has the name of its column."""
        names = [
            f"{before} {name}" if name == INTERVAL else name
            for before, name in zip(["", *self.head], self.head, strict=False)
        ]
        rows = [{name: _plain(cell) for name, cell in zip(names, row, strict=True)} for row in self.rows]
        return {"caption": self.caption, "rows": rows} if self.caption else {"rows": rows}


def show(value: Value, decimals: int | None = 1) -> str:
    """Format a value as tables show it.

    >>> show(93.14), show(1.656, 2), show(0.01234, None), show(2484.2, None), show(12345), show(float("nan"))
    ('93.1', '1.66', '0.0123', '2,484', '12,345', '-')
    """
    if value is None or (isinstance(value, float) and not isfinite(value)):
        return UNKNOWN
    if isinstance(value, str):
        return value
    if isinstance(value, int):
        return f"{value:,}"
    if decimals is None:
        return f"{value:.3g}" if abs(value) < _LARGE else f"{value:,.0f}"
    return f"{value:.{decimals}f}"


def _is_text(cells: Sequence[Value]) -> bool:
    known = [cell for cell in cells if isinstance(cell, str)]
    return bool(known) and all(any(letter.isalpha() for letter in cell) for cell in known)


def _plain(value: Value) -> Value:
    """Return a value for JSON: six significant digits; None instead of NaN and infinity."""
    if isinstance(value, float):
        return float(f"{value:.6g}") if isfinite(value) else None
    return value


def counted(count: int, noun: str) -> str:
    """Return a number with its noun.

    >>> counted(1, "session"), counted(2000, "session")
    ('1 session', '2,000 sessions')
    """
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"
