"""Table of a text file: its encoding, separator, line of names and row of units are detected."""

import codecs
import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
import polars as pl

from connectors.files.column_map import SEPARATORS
from connectors.files.raw_table import RawTable, check_size
from connectors.files.roles import unit_in
from operators.errors import InputError

IN_PYTHON: Final = "read it in Python and pass a DataFrame to import_frame, see docs/how-to/import.md"

_HEAD: Final = 1 << 20  # bytes in which the names and the first rows must be
_LINES: Final = 60  # that decide
_FEW, _FIELDS = 20, 20_000  # lines at least; fields at most
_WIDE: Final = 20  # values of a row that may be a channel
_COMMENT: Final = re.compile(r"\s*[#%]+\s*")
_WORDS: Final = re.compile(r'^\s*"?[^\W\d]\w*"?\s*,|,\s*"?[^\W\d]\w*"?\s*(,|$)')  # fields between commas
_NAMES: Final = {sign: name for name, sign in SEPARATORS.items()}
_DATE: Final = r"\d{1,4}[-/. ](\d{1,2}|[a-z]{3})[-/. ]\d{1,4}"
_VALUE: Final = re.compile(  # a number, a date, a time, or nothing
    r"|[+\-\u2212]?[\d.,'\u2019\u00a0\u202f ]*\d[\d.,]*(e[+-]?\d+)?"
    rf"|[+-]?(nan|inf|na|<na>|n/a|null|none|true|false)|{_DATE}|((\d{{8}}|{_DATE}|\d+ days?)[T_,; ]+)?"
    r"\d{1,2}:\d{2}[\d:.,]*( ?[ap]m)?( ?(z|utc|gmt|[+-]\d\d(:?\d\d)?))?",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class _Shape:
    """Form of a text file."""

    separator: str
    width: int  # fields of a row
    names: tuple[str, ...]  # of the columns; an empty one: it has none
    units: tuple[str, ...]  # of a row below the names; empty: there is none
    first: int  # number of lines above the first row
    named_by: int  # number of the line of names; 0: there is none


def parse_text(content: bytes, where: str, sha256: str = "", separator: str | None = None) -> RawTable:
    """Parse the content of a text file with a row of values per line.

    Lines above the names are skipped. Columns without a name are ``column1``, ``column2``, .... The default
    `separator` is the tab, semicolon, pipe or comma of most lines, else blanks.

    Raises:
        InputError: if it is too large or not a table.
    """
    notes = list[str]()
    content = _utf8(content, where, notes)
    if not content.strip():
        raise InputError(where, "is empty: its first line must name the columns")
    lines = content[:_HEAD].decode("utf-8", "replace").split("\n")
    if len(content) > _HEAD and len(lines) == 1:
        raise InputError(where, "has a line of more than 1 MiB: is it a table with a row per time?")
    shape = _shape(lines[:_LINES], where, SEPARATORS[separator] if separator else None)
    notes += [f"separator {_NAMES[shape.separator]}"] if shape.separator != "," else []
    if shape.named_by != 1:
        notes.append(f"names in line {shape.named_by}" if shape.named_by else "without names of columns")
    notes += [] if content.endswith(b"\n") else ["the last line has no end: was it cut off?"]
    return _parsed(content, where, shape, sha256, notes)


def split_line(line: str, separator: str) -> list[str]:
    """Split a line into its fields, without blanks around them.

    >>> split_line('0,5; "a; b" ;3;', ";"), split_line("1   2", " ")
    (['0,5', 'a; b', '3', ''], ['1', '2'])
    """
    if separator == " ":
        return line.split()
    if '"' not in line:
        return [each.strip() for each in line.split(separator)]
    try:
        rows = list(csv.reader([line.strip()], delimiter=separator, skipinitialspace=True))
    except csv.Error:
        rows = [[line]]
    return [each.strip() for row in rows for each in row]


def named(fields: Sequence[str]) -> list[str]:
    """Return the names of columns; one without a name is ``column1``, ``column2``, ..., by its place."""
    return [each.strip() or f"column{number}" for number, each in enumerate(fields, 1)]


def _utf8(content: bytes, where: str, notes: list[str]) -> bytes:
    """Return text in UTF-8 or Windows-1252 as UTF-8 with lines that end with a line feed."""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise InputError(where, "is text in UTF-16: save it as UTF-8")
    try:
        content.decode()
    except UnicodeError:
        content = content.decode("cp1252", "replace").encode()
        notes.append("Windows-1252")
    if b"\0" in content:
        raise InputError(
            where, f"is no text, it has bytes of zero: decompress it, save it as CSV in UTF-8, or {IN_PYTHON}"
        )
    content = content.removeprefix(codecs.BOM_UTF8)
    return content.replace(b"\r", b"\n") if b"\n" not in content else content


def _shape(lines: Sequence[str], where: str, stated: str | None) -> _Shape:
    """Return the form of a file by its first lines."""
    most = max(line.count(sign) for line in lines for sign in _NAMES)
    check_size(where, 0, most + 1)
    lines = lines[: max(_FEW, _FIELDS // (most + 1))]
    sign = stated or _separator(lines)
    rows = _rows(lines, sign)
    if not rows:
        raise InputError(where, "has no rows of numbers below a line that names the columns")
    first, fields, width = min(rows), [*rows.values()], len(rows[min(rows)])
    channels = {row[0] for row in fields if not _VALUE.fullmatch(row[0])}
    if width > max(_WIDE, 3 * len(fields)) and len(channels) == len(fields) > 1:
        reason = f"has a row per channel ({', '.join(sorted(channels)):.60}): transpose it to a row per time"
        raise InputError(where, reason)
    above = [number for number in range(first) if len(split_line(lines[number], sign)) >= width - 1]
    words = [place for place, each in enumerate(fields[0]) if not _VALUE.fullmatch(each)]
    if not above and any(all(_VALUE.fullmatch(row[place]) for row in fields[1:]) for place in words):
        first = min([*rows][1:], default=first + 1)  # names such as t,1,2,3
    above = [number for number in range(first) if lines[number].strip()]
    units = [each.strip("[](){}<> ") for each in _fields(lines[above[-1]], sign)] if above[1:] else []
    filled = [each for each in units if each.strip("-")]
    enough = len(filled) / 2 if len({*filled}) == len(filled) else 0  # of s,inH2O,inH2O one suffices
    known = sum(bool(unit_in(each)) for each in filled) > enough
    widths = [len(_fields(lines[number], sign)) for number in above[-2:]]  # of the names, and of the units
    units = units if known and min(widths) >= width - 1 else []
    above = above[:-1] if units else above
    names = _fields(lines[above[-1]], sign) if above else []
    if (len(names) == 1 and width > 2) or all(_VALUE.fullmatch(each) for each in names):
        return _Shape(sign, width, ("",) * width, tuple(units), first, 0)
    return _Shape(sign, width, tuple(names), tuple(units), first, above[-1] + 1)


def _separator(lines: Sequence[str]) -> str:
    """Return the sign that separates the fields of most lines; a comma may also be that of decimals."""
    signs, named = list[str](), any(map(_WORDS.search, lines))
    for line in filter(re.compile(r"\s*(?=[^#%\s]).*\d").match, reversed(lines)):
        bare = re.sub(rf'"[^"]*"|{_DATE}[T_ ]+', "", line, flags=re.IGNORECASE)
        comma = "," in bare and (named or not re.search(r"\d +-?\d", bare))
        signs.append(next((sign for sign in "\t;|" if sign in bare), "," if comma else " "))
    return max(signs, key=signs.count, default=",")


def _fields(line: str, sign: str) -> list[str]:
    """Return the fields of a line above the rows, which may be a comment."""
    return split_line(_COMMENT.sub("", line, count=1) if _COMMENT.match(line) else line, sign)


def _rows(lines: Sequence[str], sign: str) -> dict[int, list[str]]:
    """Return the fields of the lines that are rows of values of the most frequent width, by their index."""
    rows = dict[int, list[str]]()
    for number, line in enumerate(lines):
        fields = [] if _COMMENT.match(line) else split_line(line, sign)
        filled = [each for each in fields if each]
        if filled and 2 * sum(bool(_VALUE.fullmatch(each)) for each in filled) >= len(filled):
            rows[number] = fields
    widths = Counter(map(len, rows.values()))
    width = max(widths, key=lambda each: (widths[each], each), default=0)
    return {number: each for number, each in rows.items() if len(each) == width}


def _parsed(content: bytes, where: str, shape: _Shape, sha256: str, notes: list[str]) -> RawTable:
    """Return the table of a file of known form."""
    sign, names, body = shape.separator, shape.names, content
    for _ in range(shape.first):
        body = body.partition(b"\n")[2]
    if sign == " ":
        body = b"\n".join(b" ".join(line.split()) for line in body.split(b"\n"))
    check_size(where, body.count(sign.encode()) + body.count(b"\n") + 1)
    last = split_line(body.rstrip(b"\r\n ").rpartition(b"\n")[2].decode("utf-8", "replace"), sign)
    if len(last) < min(shape.width, len(names)):
        reason = f"the last line has fewer fields than line {shape.first + 1}: it is cut off, delete it"
        raise InputError(where, reason)
    frame = _frame(body, where, shape)
    filled = frame.select(pl.all().fill_null("") != "")
    again = [pl.col(column) == name for column, name in zip(frame.columns, names, strict=True)]
    named_again = pl.all_horizontal(again).fill_null(value=False)  # by a logger that started again
    keep = filled.select(pl.any_horizontal(pl.all())).to_series() & ~frame.select(named_again).to_series()
    numbers, left = np.flatnonzero(keep.to_numpy()) + shape.first + 1, len(keep) - int(keep.sum())
    many = f"{left} line{'s' * (left > 1)}"
    notes += [f"left out {many} without values, or with the names again"] if left else []
    frame = frame.filter(keep)
    often, columns = Counter(named(names)), dict[str, pl.Series]()
    for name, given, column, used in zip(named(names), names, frame, filled, strict=True):
        if often[name] == 1 and (given or used.any()):
            columns[name] = column.alias(name)
    left_out = {name: "it occurs twice" for name, many in often.items() if many > 1}
    units = dict(zip(named(names), shape.units, strict=False))
    return RawTable(columns, where, "line", numbers, units, _NAMES[sign], left_out, sha256, notes)


def _frame(body: bytes, where: str, shape: _Shape) -> pl.DataFrame:
    """Parse the columns that have names as text; a separator may end each row."""
    sign, width = shape.separator, len(shape.names)
    schema = {f"{number}": pl.String for number in range(width)}
    text = (sign * (width - 1) + "\n").encode() + body  # the first line is the widest
    read = partial(pl.read_csv, text, has_header=False, schema=schema, separator=sign)
    try:
        frame = read()[1:]
    except pl.exceptions.PolarsError:
        for number, line in enumerate(body.decode("utf-8", "replace").split("\n"), shape.first + 1):
            if any(split_line(line, sign)[width:]):
                than = f"line {shape.named_by} has names" if shape.named_by else f"line {shape.first + 1}"
                reason = f"has more fields than {than}; a {_NAMES[sign]} in a value needs quotes"
                raise InputError(f"{where}, line {number}", reason) from None
        try:
            frame = read(truncate_ragged_lines=True)[1:]
        except pl.exceptions.PolarsError as error:
            raise InputError(where, f"is not a CSV file: {str(error).splitlines()[0]}") from None
    torn = [column.str.contains("\n", literal=True).arg_true()[:1] for column in frame]
    if rows := [row for each in torn for row in each]:  # an unpaired quotation mark
        reason = "has a quoted field that spans lines: close its quotation mark"
        raise InputError(f"{where}, line {min(rows) + shape.first + 1}", reason)
    return frame.select(pl.all().str.strip_chars())
