"""Tables of a report: values are kept as numbers and formatted on output."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from math import isfinite
from typing import Any, Final, TypeAlias

from flows.report.markup import html_text, plain_text

Value: TypeAlias = str | float | int | None  # None, NaN and infinity: unknown
UNKNOWN: Final = "-"  # unknown values in tables
_PHONE: Final = 48  # characters; a wider table is shown as a list on a phone
_BREAK: Final = re.compile(r"\s|(?<=_)|(?<=/)(?=\w{3})")  # places where a line may end; not in cm/s
_LARGE: Final = 999.5  # numbers from here on have no exponent
_GAP: Final = 1  # character between columns


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
        """Return a padded Markdown table, which also reads as plain text."""
        head, *texts = ([cell.replace("|", r"\|") for cell in line] for line in (self.head, *self._texts()))
        widths = [max(3, *(len(line[column]) for line in [head, *texts])) for column in range(len(head))]
        left = self._left()
        rule = ["-" * w if text else "-" * (w - 1) + ":" for w, text in zip(widths, left, strict=True)]
        lines = [
            " | ".join(
                cell.ljust(w) if text else cell.rjust(w)
                for cell, w, text in zip(line, widths, left, strict=True)
            )
            for line in (head, rule, *texts)
        ]
        table = "\n".join(f"| {line} |" for line in lines)
        return f"{self.caption}\n\n{table}" if self.caption else table

    def html(self) -> str:
        """Return the table as an HTML element; on a phone a wide one is a list with the head in each row."""
        texts, kinds = self._texts(), [' class="text"' if text else "" for text in self._left()]
        names = [f' data-head="{escape(plain_text(name))}"' for name in self.head]

        def row(tag: str, cells: Sequence[str], attributes: Sequence[str]) -> str:
            parts = zip(cells, kinds, attributes, strict=True)
            return "".join(f"<{tag}{kind}{name}>{_breakable(cell)}</{tag}>" for cell, kind, name in parts)

        caption = f"<caption>{html_text(self.caption)}</caption>" if self.caption else ""
        head = row("th", self.head, [' scope="col"'] * len(self.head))
        body = "\n".join(f"<tr>{row('td', cells, names)}</tr>" for cells in texts)
        wide = " wide" if self._least_width(texts) > _PHONE else ""
        table = f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>\n{body}\n</tbody></table>"
        return f'<div class="scroll{wide}" tabindex="0">{table}</div>'

    def json(self) -> dict[str, Any]:
        """Return the table as JSON data; unknown values are null."""
        rows = [{name: _plain(cell) for name, cell in zip(self.head, row, strict=True)} for row in self.rows]
        return {"caption": plain_text(self.caption), "rows": rows} if self.caption else {"rows": rows}

    def _texts(self) -> list[list[str]]:
        digits = [self.decimals.get(name, 1) for name in self.head]
        return [[show(cell, number) for cell, number in zip(row, digits, strict=True)] for row in self.rows]

    def _least_width(self, texts: Sequence[Sequence[str]]) -> int:
        """Return the width of the table, in characters, if lines break wherever they can."""
        columns = zip(self.head, *texts, strict=True)
        words = [[len(word) for cell in cells for word in _BREAK.split(cell)] for cells in columns]
        return sum(max(each, default=0) + _GAP for each in words)

    def _left(self) -> list[bool]:
        """Return which columns are aligned left."""
        columns = [[row[column] for row in self.rows] for column in range(len(self.head))]
        return [not number or _is_text(cells) for number, cells in enumerate(columns)]


def _breakable(text: str) -> str:
    """Return a text as HTML whose lines may also end after an underscore, or a slash before a word."""
    return re.sub(r"(?<=\w)(_(?=\w)|/(?=\w{3}))", r"\1<wbr>", html_text(text))


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


def quantity(value: float, unit: str = "", decimals: int = 1) -> str:
    """Return a number with its unit as part of a sentence.

    >>> quantity(93.14, "%"), quantity(30.0, "ms", 0), quantity(float("nan"), "%")
    ('93.1 %', '30 ms', 'unknown')
    """
    return f"{value:.{decimals}f} {unit}".rstrip() if isfinite(value) else "unknown"


def _is_text(cells: Sequence[Value]) -> bool:
    known = [cell for cell in cells if isinstance(cell, str)]
    return bool(known) and all(any(letter.isalpha() for letter in cell) for cell in known)


def _plain(value: Value) -> Value:
    """Return a value for JSON: six significant digits; None instead of NaN and infinity."""
    if isinstance(value, float):
        return float(f"{value:.6g}") if isfinite(value) else None
    return plain_text(value) if isinstance(value, str) else value


def counted(count: int, noun: str) -> str:
    """Return a number with its noun.

    >>> counted(1, "session"), counted(2000, "session")
    ('1 session', '2,000 sessions')
    """
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"
