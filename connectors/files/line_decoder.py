"""Decoder of the lines of a logger: names of columns, rows and damaged lines. No I/O."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import polars as pl

from connectors.files.column_map import DATE, SEPARATORS, TIME, ColumnMap
from connectors.files.number_format import reals
from connectors.files.readings import counts_of, touch_of
from connectors.files.text_table import named, split_line
from connectors.files.time_axis import of_numbers, of_texts
from operators.batch import Flags, Motion, Reals, Times, Touch, s
from operators.device_clock import DeviceClock
from operators.errors import EndpointError

LONGEST: Final = 1 << 16  # bytes of a line
HOPELESS: Final = 100  # lines in succession without a row, after which the device has failed
_JUMP: Final = 10 * s  # ns, longest time for which a logger holds rows back
_NEVER: Final = -(2**63)  # ns
_REMEDY: Final = "check the map, and the baud rate of a serial port"


class LineDecoder:
    """Decoder of bytes into touch, stamped in host time.

    A line with all names of the map names the columns; such a line in between, and a clock that steps back,
    mean that the logger has started again. Damaged lines are counted and left out.

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
        self._time = [name for key in (DATE, TIME) for name in columns.columns.get(key, ())]
        self._rest = b""  # of a line that is not complete
        self._wanted = self._time + columns.cell_names
        self._names = list(names)
        self._last = _NEVER  # ns of the logger's clock, of the newest row
        self._hopeless = 0  # lines since the newest row

    def skip(self, head: bytes) -> None:
        """Begin a file: take the names from its lines that are not to be decoded."""
        self._rest = b""
        lines = list(self._split(head))
        names = (self._names_in(fields) or self._numbered(fields) for fields in lines)
        self._names = next((each for each in names if each), self._names)

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
        rows = list[list[str]]()
        for fields in self._split(data[:end]):
            self._counted["lines"] += 1
            if names := self._names_in(fields):
                yield from self._touch(rows, arrival)
                rows = []
                self._counted["restarts"] += bool(self._names)
                self._names, self._last = names, _NEVER
            else:
                rows.append(fields)
        yield from self._touch(rows, arrival)
        if self._hopeless >= HOPELESS:
            self._hopeless = 0
            reason = f"the last {HOPELESS} lines have no row of the map: {self.reason}; {_REMEDY}"
            raise EndpointError(self._where, reason)

    def _split(self, data: bytes) -> Iterator[list[str]]:
        lines = data.decode("utf-8", "replace").split("\n")
        return (split_line(line, self._separator) for line in lines if line.strip())

    def _names_in(self, fields: list[str]) -> list[str]:
        """Return the names of columns in a line, which may be a comment; none if any of the map is absent."""
        names = named([fields[0].lstrip("\ufeff#% ") or fields[0], *fields[1:]])
        return names if {*self._wanted} <= {*names} else []

    def _numbered(self, fields: list[str]) -> list[str]:
        """Return the names column1, column2, ... of the fields of a line, if the map has such names."""
        names = named([""] * len(fields))
        return names if {*self._wanted} <= {*names} else []

    def _touch(self, rows: Sequence[list[str]], arrival: int) -> Iterator[Touch]:
        """Yield the rows that are not damaged as the touch of each fingertip, in host time."""
        for fields in rows if not self._names else ():
            self._names = self._names or self._numbered(fields)
        wide = len(self._names)
        torn = [row for row in rows if not wide or len(row) < wide or any(row[wide:])]
        whole = [row for row in rows if row not in torn]
        if torn and wide:
            self._damaged(len(torn), f"a line has {len(torn[-1])} of {wide} fields")
        elif torn:
            remedy = "restart the logger, or state names=(...)"
            self._damaged(len(torn), f"no line has the names {', '.join(self._wanted):.200}: {remedy}")
        if not whole:
            return
        places = [self._names.index(name) for name in self._wanted]
        clock, cells = places[: len(self._time)], places[len(self._time) :]
        time, known = self._times([" ".join(row[place] for place in clock) for row in whole])
        texts = pl.Series([row[place] for row in whole for place in cells])
        found = reals(texts, self._columns.decimal_sign)
        readings: Reals = found.to_numpy().reshape(len(whole), -1)
        readings = np.where(np.isin(readings, self._columns.missing or ()), np.nan, readings)
        counts, good = counts_of(readings, self._columns)
        good &= _known(found).reshape(good.shape)
        sound = known & good.all(axis=1)
        if not sound.all():
            row = int(np.argmin(sound))
            place = cells[int(np.argmin(good[row]))] if known[row] else clock[-1]
            reason = f"column {self._names[place]} is {whole[row][place]!r:.40}, no value of the map's format"
            self._damaged(int((~sound).sum()), reason)
        if not sound.any():
            return
        self._hopeless = 0
        counts, valid, time = counts[sound], ~np.isnan(readings[sound]), time[sound]
        host: Times = np.full(len(time), arrival)
        if self._clock:
            self._counted["restarts"] += int((time < np.append(self._last, time[:-1])).sum())
            self._last = time[-1]
            unknown = np.full((len(time), 6), np.nan)
            host = self._clock.push(Motion(host, time, unknown, unknown)).time
        yield from touch_of(self._columns, host, counts, valid).values()

    def _times(self, texts: Sequence[str]) -> tuple[Times, Flags]:
        """Return the times (n,) of the logger's clock, ns, and which are known; 0 without a clock."""
        if not self._time:
            return np.zeros(len(texts), np.int64), np.ones(len(texts), np.bool_)
        column, dates = pl.Series(texts), any(":" in text for text in texts)
        found = of_texts(column, self._columns.dates or "ymd") if dates else of_numbers(column, self._columns)
        if dates and found.null_count():
            found = found.fill_null(of_numbers(column, self._columns))
        return np.array([time or 0 for time in found.to_list()]), _known(found)

    def _damaged(self, lines: int, reason: str) -> None:
        self.reason = reason
        self._counted["damaged"] += lines
        self._hopeless += lines


def _known(values: pl.Series) -> Flags:
    """Return which values are not null (n,); for a few rows, Python is faster than Polars."""
    return np.array([each is not None for each in values.to_list()])
