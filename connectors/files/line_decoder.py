"""Decoder of the lines of a logger: names, damaged lines and starts of its clock. No I/O."""

import re
from collections.abc import Iterator, Sequence
from datetime import date
from typing import Final, NamedTuple

import numpy as np

from connectors.files.column_map import DATE, SEPARATORS, TIME, UNITS, ColumnMap
from connectors.files.decoding import Decoder
from connectors.files.number_format import MISSING
from connectors.files.resolution import COUNT_LIMIT
from connectors.files.text_table import named, split_line
from connectors.files.time_axis import continued
from operators.batch import Counts, Flags, Motion, Times, Touch, s
from operators.device_clock import DeviceClock
from operators.errors import EndpointError, InputError

LONGEST: Final = 1 << 16  # bytes of a line
HOPELESS: Final = 100  # lines in succession without a row, after which the device has failed
_RESTART: Final = 3  # rows in order that show that the clock has started again, not that a line is damaged
_JUMP: Final = 10 * s  # ns, longest time for which a logger holds rows back
_ORDERS: Final = {"ymd": (0, 1, 2), "dmy": (2, 1, 0), "mdy": (2, 0, 1)}
_FIRST_YEAR: Final = 1000
_LATEST: Final = 2**63  # ns
_1970: Final = date(1970, 1, 1).toordinal()
_STAMP: Final = re.compile(
    r"(?:(\d{4}|\d\d?)[-./](\d\d?)[-./](\d{4}|\d\d?)[T ])?(\d\d?):(\d\d):(\d\d)(?:[.,](\d{1,9}))?Z?",
    re.ASCII,
)
_REMEDY: Final = "check the map, and the baud rate of a serial port"


class _Row(NamedTuple):
    """Row of all fingertips."""

    time: int  # ns, of the logger's clock; 0 if the lines have no time
    counts: Counts  # (cells of all fingertips)
    valid: Flags  # (cells of all fingertips)


class LineDecoder:
    """Decoder of bytes into touch, stamped in host time.

    The first line with all names of the map names the columns; such a line in between means that the logger
    has started again. Damaged lines are counted and left out.

    Args:
        where: Name of the file or port, for errors.
        columns: Complete map of columns.
        names: Names of the columns; empty: the logger sends them.
        counted: Counters, incremented: ``lines``, of these ``damaged``, and ``restarts`` of the logger.

    Attributes:
        reason: Reason of the newest damage; empty: none.
    """

    def __init__(self, where: str, columns: ColumnMap, names: Sequence[str], counted: dict[str, int]) -> None:
        self._where, self._columns, self._counted, self.reason = where, columns, counted, ""
        self._separator = SEPARATORS[columns.separator or "comma"]
        self._clock = DeviceClock(jump=_JUMP) if TIME in columns.columns else None  # None: time of arrival
        self._period = s / (columns.rate or 1.0)  # ns
        self._rest = b""  # of a line that is not complete
        self._names = tuple[str, ...]()
        self._last: int | None = None  # ns, time of the newest row
        self._wrapped = 0  # ns, added to the clock because it has 32 bits
        self._suspects = list[_Row]()  # rows that are earlier than those before them
        self._hopeless = 0  # lines since the newest row
        self._values: _PlainValues
        if names:
            self._name(names)

    def skip(self, head: bytes) -> None:
        """Take the names from the lines of a file that are not to be decoded."""
        for fields in self._split(head):
            if self._is_named(named(fields)) or self._is_named(named([""] * len(fields))):
                return

    def start_again(self) -> None:
        """Forget an incomplete line: the next byte begins a new file."""
        self._rest = b""

    def feed(self, data: bytes, arrival: int) -> Iterator[Touch]:
        """Yield the rows that bytes complete, which arrived at an instant (ns).

        Raises:
            EndpointError: if the bytes are no lines, or if many lines in succession are no rows.
        """
        data = self._rest + data.replace(b"\r", b"\n")
        end = data.rfind(b"\n") + 1
        self._rest = data[end:]
        if len(self._rest) > LONGEST:
            raise EndpointError(self._where, f"sends no end of a line in {LONGEST} bytes: {_REMEDY}")
        rows = list[_Row]()
        for fields in self._split(data[:end]):
            self._counted["lines"] += 1
            if (row := self._row(fields)) is not None:
                rows += self._ordered(row)
        if rows:
            self._hopeless = 0
            yield from self._touch(rows, arrival)
        if self._hopeless >= HOPELESS:
            self._hopeless = 0
            reason = f"the last {HOPELESS} lines have no row of the map: {self.reason}; {_REMEDY}"
            raise EndpointError(self._where, reason)

    def _split(self, data: bytes) -> Iterator[list[str]]:
        lines = data.decode("utf-8", "replace").split("\n")
        return (split_line(line, self._separator) for line in lines if line.strip())

    def _row(self, fields: list[str]) -> _Row | None:
        """Return a line as a row; None if it names the columns or is damaged."""
        if self._names:
            if (row := self._values.row(fields)) is not None:
                return row
            try:
                return self._slowly(fields)
            except InputError as error:
                reason = str(error)
        else:
            wanted = ", ".join(name for names in self._columns.columns.values() for name in names)
            reason = f"no line has the names {wanted:.200}: restart the logger, or state names=(...)"
        before = self._names
        if self._is_named(named(fields)):
            self._counted["restarts"] += bool(before)
            self._forget_suspects()
            self._last, self._wrapped = None, 0
        elif not before and self._is_named(named([""] * len(fields))):  # the map has column1, column2, ...
            return self._row(fields)
        else:
            self._damaged(1, reason)
        return None

    def _slowly(self, fields: list[str]) -> _Row:
        """Return a row with values in any format, such as dates or grouped digits.

        Raises:
            InputError: if it is not valid.
        """
        if len(fields) < len(self._names):
            raise InputError(self._where, f"a line has {len(fields)} of {len(self._names)} fields")
        found = self._decoder.decode([fields], self._counted["lines"])
        counts, valid = (
            np.concatenate([getattr(touch, name)[0] for touch in found.touch.values()])
            for name in ("counts", "valid")
        )
        return _Row(found.time.item(0), counts, valid)

    def _ordered(self, row: _Row) -> list[_Row]:
        """Return the row; none if its time goes back; the last ones if their clock has started again."""
        time, last = row.time + self._wrapped, self._last
        if last is not None and time < last:
            time = continued(np.array([last, time]), [], self._period).item(1)
        if last is None or time >= last:
            self._forget_suspects()
            self._last, self._wrapped = time, time - row.time
            return [row._replace(time=time)]
        if self._suspects and row.time < self._suspects[-1].time:
            self._forget_suspects()
        self._suspects.append(row)
        if len(self._suspects) < _RESTART:
            return []
        rows, self._suspects = self._suspects, []
        self._counted["restarts"] += 1
        self._last, self._wrapped = row.time, 0
        return rows

    def _touch(self, rows: Sequence[_Row], arrival: int) -> Iterator[Touch]:
        """Yield rows as the touch of each fingertip, in host time."""
        time: Times = np.full(len(rows), arrival)
        if self._clock:
            unknown, device = np.full((len(rows), 6), np.nan), np.array([row.time for row in rows])
            time = self._clock.process(Motion(time, device, unknown, unknown)).time
        counts, valid = np.array([row.counts for row in rows]), np.array([row.valid for row in rows])
        first = 0
        for finger, names in self._columns.cells.items():
            cells = slice(first, first := first + len(names))
            none = np.zeros_like(counts[:, cells])
            yield self._columns.kind(time, counts[:, cells], none, valid[:, cells], finger=finger)

    def _forget_suspects(self) -> None:
        self._damaged(len(self._suspects), "its time is earlier than that of the line before")
        self._suspects = []

    def _damaged(self, lines: int, reason: str) -> None:
        if lines:
            self.reason = reason
            self._counted["damaged"] += lines
            self._hopeless += lines

    def _is_named(self, names: Sequence[str]) -> bool:
        """Use the names of the columns, if those of the map are among them; the line may be a comment."""
        try:
            self._name([names[0].lstrip("\ufeff#% ") or names[0], *names[1:]])
        except InputError:
            return False
        return True

    def _name(self, names: Sequence[str]) -> None:
        """Use the names of the columns.

        Raises:
            InputError: if names of the map are missing.
        """
        self._decoder = Decoder(self._columns, names, self._where)
        self._names, self._values = tuple(names), _PlainValues(self._columns, names)


class _PlainValues:
    """Fast conversion of a row whose values are plain numbers; it takes about 0.1 ms, a `Decoder` 27 ms.

    Args:
        columns: Complete map of columns.
        names: Names of the columns.
    """

    def __init__(self, columns: ColumnMap, names: Sequence[str]) -> None:
        self._columns, self._width = columns, len(names)
        places = [names.index(name) for each in (DATE, TIME) for name in columns.columns.get(each, ())]
        self._time, self._order = places, _ORDERS[columns.dates or "ymd"]
        self._scale = UNITS[TIME][columns.units.get(TIME, "s")]  # ns
        self._cells = [names.index(name) for name in columns.cell_names]
        self._resolution, self._offset = columns.resolution or 1.0, np.array(columns.offset or (0,))
        self._missing = columns.missing or ()

    def row(self, fields: Sequence[str]) -> _Row | None:
        """Return a row; None if its values are no plain numbers."""
        if len(fields) < self._width or any(fields[self._width :]):
            return None
        try:
            time = self._nanoseconds(" ".join(fields[place] for place in self._time)) if self._time else 0
            readings = np.array([self._number(fields[place]) for place in self._cells])
        except ValueError:
            return None
        readings[np.isin(readings, self._missing)] = np.nan
        valid: Flags = ~np.isnan(readings)
        counts = np.where(valid, np.rint(readings / self._resolution - self._offset), 0)
        whole = not self._columns.has_counts or bool((readings[valid] == np.rint(readings[valid])).all())
        if not whole or (np.abs(counts) > COUNT_LIMIT).any():
            return None
        return _Row(time, counts.astype(np.int16), valid)

    def _nanoseconds(self, text: str) -> int:
        """Return a time; a date counts since 1970, a time of day since midnight.

        Raises:
            ValueError: if it is neither a plain number nor a usual date.
        """
        if ":" not in text:
            whole = text.isdigit() and text.isascii()
            time = int(text) * round(self._scale) if whole else round(self._number(text) * self._scale)
        else:
            if (found := _STAMP.fullmatch(text)) is None:
                raise ValueError(text)
            *day, hour, minute, second, share = found.groups()
            if not (int(hour) < 24 and int(minute) < 60 and int(second) < 60):
                raise ValueError(text)
            year, month, number = (int(day[place] or 0) for place in self._order)
            days = date(year, month, number).toordinal() - _1970 if day[0] else 0
            if day[0] and year < _FIRST_YEAR:  # of two digits
                raise ValueError(text)
            seconds = ((days * 24 + int(hour)) * 60 + int(minute)) * 60 + int(second)
            time = seconds * s + int((share or "0").ljust(9, "0"))
        if abs(time) >= _LATEST:
            raise ValueError(text)
        return time

    def _number(self, text: str) -> float:
        """Return a number; NaN for a missing one.

        Raises:
            ValueError: if it is no plain number.
        """
        if text.lower() in MISSING:
            return np.nan
        if self._columns.decimal_sign == ",":
            if "." in text:
                raise ValueError(text)
            text = text.replace(",", ".")
        value = float(text)
        if not np.isfinite(value) or "_" in text or not text.isascii():
            raise ValueError(text)
        return value
