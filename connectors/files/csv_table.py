"""Strict parser of CSV, which detects the separator; errors name the line and the column."""

import codecs
import csv
import io
import re
from collections import Counter
from collections.abc import Sequence
from itertools import islice
from typing import Final

import numpy as np
import polars as pl

from connectors.files.trace_table import TraceTable, check_size
from operators.errors import InputError

SEPARATORS: Final = {",": "comma", ";": "semicolon", "\t": "tab", " ": "space"}
COLUMN_LIMIT: Final = 4096

_ASSUMED: Final = 20  # lines that decide on the separator
_DECIMAL_COMMA: Final = r"^\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*$"
_QUOTED: Final = re.compile(r'"(?:[^"]|"")*"')


def parse_csv(content: bytes, where: str, sha256: str = "") -> TraceTable:
    """Parse the content of a CSV file, whose first line names the columns.

    Lines above it that start with ``#`` are comments. Numbers may have a decimal comma, unless it separates.

    Args:
        content: The content.
        where: Name of the file.
        sha256: Checksum of the file, hex.

    Raises:
        InputError: if it is too large or not a table.
    """
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise InputError(where, "is UTF-16: save it as UTF-8")
    above, content = _without_comments(content.removeprefix(codecs.BOM_UTF8))
    sign = detected(_lines(content, _ASSUMED))
    notes = [] if sign == "," else [f"separator {SEPARATORS[sign]}"]
    if sign == " ":
        content = b"\n".join(b" ".join(line.split()) for line in content.splitlines())
    check_size(where, content.count(sign.encode()) + content.count(b"\n") + 1)
    named_by = f"line {above + 1}"
    frame = _frame(where, content, sign, above, named_by)
    if _last_line(content).count(sign.encode()) < frame.width - 1:
        reason = f"the last line has fewer fields than {named_by} has names: it is cut off, delete it"
        raise InputError(where, reason)
    filled = ~frame.select(pl.all_horizontal(pl.all().is_null())).to_series()
    numbers = np.flatnonzero(filled.to_numpy()) + above + 2  # (n,) line numbers
    frame = frame if filled.all() else frame.filter(filled)
    if sign != "," and frame.select(pl.any_horizontal(pl.all().str.contains(_DECIMAL_COMMA)).any()).item():
        notes.append("decimal comma")
        point = pl.all().str.replace(",", ".", literal=True)
        frame = frame.with_columns(
            pl.when(pl.all().str.contains(_DECIMAL_COMMA)).then(point).otherwise(pl.all())
        )
    columns, left_out = _named(frame)
    return TraceTable(
        columns,
        where,
        named_by=named_by,
        place="line",
        numbers=numbers,
        sha256=sha256,
        notes=notes,
        left_out=left_out,
    )


def _named(frame: pl.DataFrame) -> tuple[pl.DataFrame, dict[str, str]]:
    """Return the columns by their names in the file, and the names that occur twice; polars renames these."""
    stripped = [name.strip().replace('""', '"') for name in frame.columns]
    bases = [name.rpartition("_duplicated_")[0].strip() for name in stripped]
    names = [base if base in stripped else name for base, name in zip(bases, stripped, strict=True)]
    often = Counter(names)
    pairs = zip(names, frame.get_columns(), strict=True)
    columns = [column.alias(name) for name, column in pairs if often[name] == 1]
    return pl.DataFrame(columns), {name: "it occurs twice" for name in names if often[name] > 1}


def detected(lines: Sequence[str]) -> str:
    """Return the separator that divides the first lines into the most fields, equally often in each line.

    `csv.Sniffer` takes the decimal comma of ``0,01;500,5`` for the separator.

    >>> detected(["t;p0;p1", "0,01;500,5;501"]), detected(["t p0 p1", "0.01   500  501"])
    (';', ' ')
    """
    bare = [_QUOTED.sub("", line) for line in lines if line.strip()]
    best, most = ",", 0
    for sign in SEPARATORS:
        counts = {len(line.split()) - 1 if sign == " " else line.count(sign) for line in bare}
        if len(counts) == 1 and (fields := counts.pop()) > most:
            best, most = sign, fields
    if most == 0 and bare:  # lines of unequal length: the header decides
        best = max((",", ";", "\t"), key=bare[0].count)
    return best


def _lines(content: bytes, count: int) -> list[str]:
    """Return the first lines."""
    rows = io.TextIOWrapper(io.BytesIO(content[: 1 << 20]), "utf-8", "replace")
    return [line.rstrip("\r\n") for line in islice(rows, count)]


def _last_line(content: bytes) -> bytes:
    """Return the last line that is not blank; its end may be a separator."""
    end = len(content.rstrip())
    return content[content.rfind(b"\n", 0, end) + 1 :].partition(b"\n")[0]


def _without_comments(content: bytes) -> tuple[int, bytes]:
    """Return the number of comment lines at the beginning, and the content below them."""
    skipped, start = 0, 0
    while content[start : start + 1] == b"#":
        end = content.find(b"\n", start) + 1
        if not end:
            break
        skipped, start = skipped + 1, end
    return skipped, content[start:]


def _frame(where: str, content: bytes, sign: str, above: int, named_by: str) -> pl.DataFrame:
    """Parse the columns of a file as text."""
    names = content.partition(b"\n")[0]
    if names.count(b'"') % 2:  # polars would take the rows below as part of the name
        raise InputError(f"{where}, {named_by}", 'has a quoted name that is not closed: write "" for a "')
    if names.count(sign.encode()) >= COLUMN_LIMIT:
        raise InputError(where, f"has more than {COLUMN_LIMIT} columns: is it a table with a row per time?")
    try:
        frame = pl.read_csv(content, infer_schema=False, separator=sign)
    except pl.exceptions.NoDataError:
        raise InputError(where, "is empty: its first line must name the columns") from None
    except pl.exceptions.PolarsError as error:
        if line := _too_long(content, sign):
            reason = (
                f"has more fields than {named_by} has names; a {SEPARATORS[sign]} in a value needs quotes"
            )
            raise InputError(f"{where}, line {line + above}", reason) from None
        raise InputError(where, f"is not a CSV file: {str(error).splitlines()[0]}") from None
    torn = [column.str.contains("\n", literal=True).arg_true()[:1] for column in frame]
    if rows := [row for each in torn for row in each]:  # an unpaired quotation mark
        reason = "has a quoted field that spans lines: close its quotation mark"
        raise InputError(f"{where}, line {min(rows) + above + 2}", reason)
    columns = frame.get_columns()
    del frame
    for number in range(len(columns)):  # one by one, as each needs as much memory again
        columns[number] = columns[number].str.strip_chars()
    return pl.DataFrame(columns)


def _too_long(content: bytes, sign: str) -> int:
    """Return the number of the first line with more fields than line 1; 0 if there is none."""
    text = io.StringIO(content.decode("utf-8", "replace"), newline="")
    rows = csv.reader(text, delimiter=sign)
    try:
        width = len(next(rows))
        return next((rows.line_num for row in rows if len(row) > width), 0)
    except csv.Error:
        return 0
