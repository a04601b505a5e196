"""Live source of touch from the lines that a logger appends to a file or sends over a serial port."""

import asyncio
import errno
import logging
import os
import re
from collections.abc import AsyncGenerator, AsyncIterator, Sequence
from contextlib import aclosing, suppress
from dataclasses import replace
from io import FileIO
from pathlib import Path
from typing import TYPE_CHECKING, Final, cast

import numpy as np

from connectors.files.column_map import LABEL, MOTIONS, ColumnMap
from connectors.rate_check import rate_finding
from operators.batch import Touch, s
from operators.checks import check_above
from operators.device_clock import DeviceClock
from operators.errors import EndpointError, ParameterError, os_error_reason
from operators.fingertip import Fingertip
from operators.ports import Clock, Description, Finding, Json, Source

if TYPE_CHECKING:
    from connectors.files.line_decoder import LineDecoder

log = logging.getLogger("slipflow")

POLL: Final = 0.01  # s, between looks at a file that does not grow
READ: Final = 1 << 14  # bytes per turn of the event loop
HEAD: Final = 1 << 16  # bytes of a file that may contain the names
DIAGNOSIS: Final = 3.0  # s
_PORT: Final = re.compile(r"COM\d+|[a-z+]+://.*", re.IGNORECASE)  # of Windows, or a URL of pyserial
_REASONS: Final = {
    errno.ENOENT: "does not exist: is it plugged in, does the logger write there?",
    errno.EACCES: "permission denied: is the user in the group dialout?",
    errno.EBUSY: "is in use: end the other program",
    errno.EAGAIN: "is in use: end the other program",
}


class LineSource(Source[Touch]):
    """Touch from the lines of a logger, which appends them to a file or sends them over a serial port.

    Lines, numbers and times have the form of files that `slipflow import` reads, with the same map. A file is
    followed from its end on, and from its start once it is replaced or truncated. The clock of the lines is
    mapped to host time as by `DeviceClock`; without a column of times, rows have the time of their arrival.

    Damaged lines are left out, counted and logged. A line of names in between, or a clock that starts again,
    is a restart of the logger. A port that is unplugged fails and is opened again. Columns of labels and of
    motion are not read, so the map of a labelled recording will do.

    Args:
        where: Path of the file, a serial port such as ``/dev/ttyACM0`` or ``COM3``, or a URL of pyserial.
        columns: Complete map of the columns, as `slipflow import --flow` writes it, the path of its file, or
            a text such as ``time=t,counts=p0..p5,units.time=ms,rate=100``.
        baud: Bits per second of a serial port.
        names: Names of the columns in their order, for a logger that does not send them.

    Attributes:
        extra: ``serial`` for a serial port.

    Raises:
        InputError: if the map cannot be read.
        ParameterError: if the map does not state the rate, or a parameter is invalid.
    """

    def __init__(
        self,
        where: str | Path,
        columns: ColumnMap | str | Path,
        *,
        baud: int = 115_200,
        names: Sequence[str] = (),
    ) -> None:
        from connectors.files.readings import described

        self.where, self._baud, self._names = str(where), baud, tuple(names)
        if not self.where:
            raise ParameterError("LineSource", "where", where, "a file or a serial port")
        check_above("LineSource", "baud", baud, 0, "bits per second")
        found = columns if isinstance(columns, ColumnMap) else ColumnMap.load(str(columns))
        used = {name: each for name, each in found.columns.items() if name not in (*MOTIONS, LABEL)}
        self._columns = replace(found, columns=used)
        cells = self._columns.cell_names
        if not cells or "*" in "".join(cells):
            must_be = "a map that names each column of cells, as `slipflow import --flow` writes it"
            raise ParameterError("LineSource", "columns", str(columns), must_be)
        wanted = {name for each in used.values() for name in each}
        if names and (missing := wanted - {*names}):
            must_be = f"all columns of the logger, also {min(missing)} of the map"
            raise ParameterError("LineSource", "names", ",".join(names), must_be)
        self._fingertip = described(self._columns)
        self._serial = _is_port(self.where)
        self.extra = "serial" if self._serial else ""
        self._counted = {"lines": 0, "damaged": 0, "restarts": 0}
        self._damage = ""  # reason of the newest damaged line
        self._read: tuple[int, int] | None = None  # inode of the file, and bytes; None: begin at its end

    @property
    def kind(self) -> type[Touch]:
        """Type of the batches: raw counts, or zeroed ones if the map says so."""
        return self._columns.kind

    @property
    def fingers(self) -> tuple[int, ...]:
        """Fingertips of the lines."""
        return tuple(self._columns.cells)

    @property
    def fingertip(self) -> Fingertip:
        """Fingertip that the map describes."""
        return self._fingertip

    def describe(self) -> Description:
        """Return source and counts of lines, which are updated live."""
        return {"source": self.where, "lines": cast("dict[str, Json]", self._counted)}

    async def prepare(self) -> None:
        """Compile the conversion of times."""
        await asyncio.to_thread(DeviceClock().prepare)

    async def batches(self, clock: Clock) -> AsyncIterator[Touch]:
        """Yield the rows of the complete lines as they arrive.

        Raises:
            EndpointError: if the file or port cannot be read, or sends no rows.
        """
        from connectors.files.line_decoder import LineDecoder

        decoder = LineDecoder(self.where, self._columns, self._names, self._counted)
        chunks = self._read_port() if self._serial else self._follow_file(decoder)
        async with aclosing(chunks):
            async for data in chunks:
                damaged = self._counted["damaged"]
                for touch in decoder.feed(data, clock.now()):
                    yield touch
                self._damage = decoder.reason
                self._report(damaged)

    async def diagnose(self, clock: Clock) -> AsyncGenerator[Finding]:
        """Read for some seconds: lines, damaged ones, and the rate of the rows.

        Raises:
            EndpointError: if the file or port cannot be read, or sends no rows.
        """
        await self.prepare()
        time, before = list[int](), {**self._counted}
        batches = cast("AsyncGenerator[Touch]", self.batches(clock))
        with suppress(TimeoutError):
            async with asyncio.timeout(DIAGNOSIS), aclosing(batches):
                async for touch in batches:
                    if touch.finger == self.fingers[0]:
                        time += touch.time.tolist()
        lines, damaged = (self._counted[name] - before[name] for name in ("lines", "damaged"))
        if not lines:
            remedy = f"is {self._baud} its baud rate?" if self._serial else "does it grow?"
            yield Finding(self.where, f"sent no line for {DIAGNOSIS:g} s: is the logger on, {remedy}", "bad")
            return
        text = f"{len(time)} rows in {lines} lines, {damaged} damaged"
        good = len(time) > 1 and damaged <= lines / 100
        remedy = (
            "" if good else f": {self._damage}; check the map, and the cable and baud rate of a serial port"
        )
        yield Finding(self.where, text + remedy, "good" if good else "bad")
        settled = np.array(time[len(time) // 2 :])  # the conversion to host time knows the delay by then
        if len(settled) and np.ptp(settled) > s:
            remedy = "correct the rate in the map, or the rate of the logger"
            yield rate_finding(self.where, settled, self._fingertip.rate, remedy)

    def _report(self, before: int) -> None:
        """Log the first, the tenth, the hundredth, ... damaged line."""
        damaged = self._counted["damaged"]
        if damaged > before and (not before or len(str(damaged)) > len(str(before))):
            log.warning("%s: %d damaged lines so far; the newest: %s", self.where, damaged, self._damage)

    async def _read_port(self) -> AsyncGenerator[bytes]:
        """Yield what arrives at the serial port."""
        from serial_asyncio_fast import open_serial_connection

        try:
            reader, writer = await open_serial_connection(url=self.where, baudrate=self._baud, exclusive=True)
        except (OSError, ValueError) as error:
            raise EndpointError(self.where, _reason(error)) from error
        try:
            while data := await reader.read(READ):
                yield data
            raise EndpointError(self.where, "was closed: is it still plugged in?")
        except OSError as error:
            raise EndpointError(self.where, f"was unplugged: {error}") from error
        finally:
            writer.close()
            with suppress(OSError):
                await writer.wait_closed()

    async def _follow_file(self, decoder: "LineDecoder") -> AsyncGenerator[bytes]:
        """Yield what is appended to the file, and all of a file that replaces it."""
        while True:
            try:
                file = FileIO(self.where)
            except OSError as error:
                self._read = self._read or (0, 0)  # a new file is read from its start
                raise EndpointError(self.where, _reason(error)) from error
            with file:
                status = os.fstat(file.fileno())
                number, position = self._read or (status.st_ino, _end_of_lines(file, status.st_size))
                if status.st_ino != number or status.st_size < position:
                    position = 0
                file.seek(0)
                decoder.skip((file.read(min(HEAD, position)) or b"").rpartition(b"\n")[0])
                file.seek(position)
                self._read = status.st_ino, position
                while (data := file.read(READ)) or not self._is_replaced():
                    if data:
                        self._read = status.st_ino, file.tell()
                        yield data
                    await asyncio.sleep(0 if data else POLL)
            self._read = (0, 0)  # the next file is read from its start, even if it is longer by then

    def _is_replaced(self) -> bool:
        """Return True if the path has another file now, or the file has become shorter."""
        with suppress(OSError):  # a logger may rename the file before it creates the next one
            status = os.stat(self.where)  # noqa: PTH116 - once per poll
            number, position = self._read or (0, 0)
            return status.st_ino != number or status.st_size < position
        return False


def _is_port(where: str) -> bool:
    """Return True for a serial port or a URL, False for a file."""
    device = where.startswith("/dev/") and not Path(where).is_file()
    return device or bool(_PORT.fullmatch(where))


def _end_of_lines(file: FileIO, size: int) -> int:
    """Return the position after the last complete line of a file."""
    start = max(0, size - HEAD)
    file.seek(start)
    return start + (file.read(HEAD) or b"").rfind(b"\n") + 1


def _reason(error: Exception) -> str:
    """Return the reason of an error, with its remedy."""
    number = error.errno if isinstance(error, OSError) else None
    if number is None and (found := re.search(r"\[Errno (\d+)\]", str(error))):  # of pyserial
        number = int(found[1])
    if reason := _REASONS.get(number or 0):
        return reason
    return os_error_reason(error) if isinstance(error, OSError) else str(error)
