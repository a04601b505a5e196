"""A page of findings as HTML and Markdown; each has a title that states it, a figure, and tables."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from math import isfinite
from typing import Final

from flows.report.figures import Figure, inline, lacking

NONE: Final = "-"  # in tables, where there is no number
_STYLE: Final = """
:root { color-scheme: light; }
body { margin: 2.5rem auto; max-width: 66rem; padding: 0 1.5rem; background: #fff; color: #22272e;
       font: 16px/1.5 system-ui, "DejaVu Sans", Helvetica, Arial, sans-serif; }
h1 { font-size: 1.6rem; line-height: 1.25; } h2 { font-size: 1.15rem; line-height: 1.3; margin-top: 3rem; }
p { max-width: 46rem; } svg { width: 100%; height: auto; max-height: 36rem; }
table { border-collapse: collapse; margin: 1rem 0; font-size: .86rem; font-variant-numeric: tabular-nums; }
div.table { overflow-x: auto; } caption { text-align: left; font-weight: 600; padding: .2rem 0; }
th, td { padding: .25rem .7rem; text-align: right; border-bottom: 1px solid #e6e9ed; white-space: nowrap; }
th.text, td.text { text-align: left; } th:first-child, td:first-child { padding-left: 0; }
th { font-weight: 600; border-bottom-color: #9aa4b0; }
pre { background: #f5f7f9; padding: .7rem 1rem; overflow-x: auto; font-size: .85rem; }
footer { margin-top: 3rem; color: #5b6672; font-size: .85rem; }
"""


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of text below a head. The first column and columns of words are aligned left, numbers right."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""

    def markdown(self) -> str:
        """Padded, so that it reads as plain text too.

        >>> print(Table(["method", "F1", "how"], [["psd", "57.5", "late"], ["tcn", "9", "-"]]).markdown())
        | method |   F1 | how  |
        | ------ | ---: | ---- |
        | psd    | 57.5 | late |
        | tcn    |    9 | -    |
        """
        lines = [self.head, *self.rows]
        wide = [max(3, *(len(line[column]) for line in lines)) for column in range(len(self.head))]
        left = self._left()
        rule = [
            "-" * width if text else "-" * (width - 1) + ":" for width, text in zip(wide, left, strict=True)
        ]
        padded = [
            [
                cell.ljust(width) if text else cell.rjust(width)
                for cell, width, text in zip(line, wide, left, strict=True)
            ]
            for line in (self.head, rule, *self.rows)
        ]
        text = "\n".join(f"| {' | '.join(line)} |" for line in padded)
        return f"{self.caption}\n\n{text}" if self.caption else text

    def html(self) -> str:
        """The same as an element."""
        starts = [' class="text"' if text else "" for text in self._left()]

        def row(tag: str, cells: Sequence[str]) -> str:
            told = zip(cells, starts, strict=True)
            return f"<tr>{''.join(f'<{tag}{start}>{escape(cell)}</{tag}>' for cell, start in told)}</tr>"

        caption = f"<caption>{escape(self.caption)}</caption>" if self.caption else ""
        body = "\n".join(row("td", cells) for cells in self.rows)
        head = f"<thead>{row('th', self.head)}</thead>"
        return f'<div class="table"><table>{caption}{head}<tbody>\n{body}\n</tbody></table></div>'

    def _left(self) -> list[bool]:
        """Which columns stand to the left."""
        columns = ([row[column] for row in self.rows] for column in range(len(self.head)))
        return [not column or _worded(cells) for column, cells in enumerate(columns)]


def _worded(cells: Sequence[str]) -> bool:
    """Whether a column is of words: there are some, and each cell that says something has letters.

    >>> _worded(["2 missed", "-"]), _worded(["1 (2)", "all"]), _worded(["1e-05"]), _worded(["-"])
    (True, False, False, False)
    """
    known = [cell for cell in cells if cell not in {"", NONE}]
    return bool(known) and not any(_numeric(cell) for cell in known)


def _numeric(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return not any(letter.isalpha() for letter in cell)
    return True


@dataclass(frozen=True, slots=True)
class Section:
    """One finding."""

    name: str  # of letters and hyphens
    title: str  # the finding, in numbers
    text: str  # what it rests on
    tables: Sequence[Table]
    figure: Figure | None = None  # None: nothing to see, or nothing that could draw it

    def html(self) -> str:
        """As an element."""
        figure = "" if self.figure is None else inline(self.figure, self.name, self.title)
        tables = "\n".join(table.html() for table in self.tables)
        title, text = escape(self.title), escape(self.text)
        return f'<section id="{self.name}">\n<h2>{title}</h2>\n<p>{text}</p>\n{figure}\n{tables}\n</section>'

    def file(self, page: str) -> str:
        """What its figure is called beside a page of that name."""
        return f"{page}.svg" if self.name == page else f"{page}-{self.name}.svg"

    def markdown(self, page: str = "") -> str:
        """With its figure as a file beside a page of that name; without a name, without figure."""
        shown = [f"![{self.name}]({self.file(page)})"] if page and self.figure is not None else []
        tables = (table.markdown() for table in self.tables)
        return "\n\n".join([f"## {self.title}", self.text, *shown, *tables])


@dataclass(frozen=True, slots=True)
class Page:
    """Findings, and the command that made them."""

    title: str
    text: str
    sections: Sequence[Section]
    command: str

    def html(self) -> str:
        """One file that needs no other."""
        sections = "\n".join(section.html() for section in self.sections)
        return (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{escape(self.title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
            f"<h1>{escape(self.title)}</h1>\n<p>{escape(self.text)}</p>\n{sections}\n"
            f"<footer>Made by<pre>{escape(self.command)}</pre></footer>\n</body>\n</html>\n"
        )

    def markdown(self, name: str = "") -> str:
        """The same for a file of that name, its figures beside it; without a name, without figures."""
        parts = [f"# {self.title}", self.text, *(section.markdown(name) for section in self.sections)]
        return "\n\n".join([*parts, f"    {self.command}"]) + "\n"


def number(value: float, decimals: int = 1) -> str:
    """A number as tables show it; `NONE` for NaN and infinity.

    >>> number(93.14), number(1.656, 2), number(float("nan"))
    ('93.1', '1.66', '-')
    """
    return f"{value:.{decimals}f}" if isfinite(value) else NONE


def drawn(draw: Callable[[], Figure]) -> Figure | None:
    """The figure that `draw` makes; None where matplotlib is not installed."""
    return None if lacking() else draw()


def terminal_text(sections: Sequence[Section]) -> str:
    """The titles and tables of sections as text for a terminal."""
    return "\n\n".join(
        part
        for section in sections
        for part in (section.title, *(table.markdown() for table in section.tables))
    )
