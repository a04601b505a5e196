"""Live source of TakkTile fingertips on an I2C bus."""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Sequence
from contextlib import aclosing
from dataclasses import replace
from typing import Final, cast

import numpy as np

from connectors.rate_check import DIAGNOSIS, rate_finding
from connectors.takktile.scanner import CONVERSION, Scan, Scanner, ScanThread
from connectors.takktile.takktile_protocol import LEAST, MOST, ROWS, Coefficients
from operators.batch import BAROMETERS, Touch, ms, s
from operators.errors import EndpointError, ParameterError
from operators.fingertip import TAKKTILE, Fingertip
from operators.ports import Clock, Description, Finding, Json, Source

VALID_LEAST: Final = 0.5  # smallest share of valid samples of a cell


class TakkTile(Source[Touch]):
    """Fingertips of six barometers each, scanned together in a separate thread.

    All barometers convert at the same time; the time of a sample is the start of the conversion. A cell is
    valid if it answers with a plausible reading; invalid cells have the received counts, or 0. A late scan
    does not delay later scans, and a missed scan is not repeated. If no cell answers for 0.25 s, the source
    fails. The bus is locked against other programs.

    Args:
        bus: Number of the I2C bus (1 for /dev/i2c-1), or its path.
        rows: Row numbers of the fingertips, 0 to 7, as programmed into their microcontrollers.
        fingers: Numbers of the fingertips in the flow (default 0, 1 and so on).
        rate: Scans per second, Hz; below 333, because a conversion takes 3 ms.

    Attributes:
        coefficients: Coefficients of the six cells, by finger; None: not read yet, or not plausible.

    Raises:
        ParameterError: on an invalid value.

    >>> takktile = TakkTile(bus=1, rows=(0, 2))
    >>> takktile.path, takktile.fingers
    ('/dev/i2c-1', (0, 1))
    """

    def __init__(
        self,
        bus: int | str = 1,
        rows: tuple[int, ...] = (0,),
        *,
        fingers: tuple[int, ...] | None = None,
        rate: float = 100.0,
    ) -> None:
        if not isinstance(cast("object", rows), tuple):  # the caller may not be type-checked
            raise ParameterError("TakkTile", "rows", rows, "a tuple, such as (0,)")
        if bus == "" or (isinstance(bus, int) and bus < 0):
            raise ParameterError("TakkTile", "bus", bus, "the number of a bus, 0 or above, or its path")
        fingers = tuple(range(len(rows))) if fingers is None else fingers
        if not rows or len(set(rows)) != len(rows) or not set(rows) <= set(range(ROWS)):
            raise ParameterError("TakkTile", "rows", rows, f"different numbers from 0 to {ROWS - 1}")
        if not len(fingers) == len(set(fingers)) == len(rows) or min(fingers) < 0:
            raise ParameterError("TakkTile", "fingers", fingers, "different numbers, one for each row")
        if not 0 < rate < s / CONVERSION:
            must_be = f"from 0 to {s / CONVERSION:.0f} Hz, because a conversion takes {CONVERSION / ms:g} ms"
            raise ParameterError("TakkTile", "rate", rate, must_be)
        self.path = f"/dev/i2c-{bus}" if isinstance(bus, int) else bus
        self.rate = rate
        self.coefficients = {finger: list[Coefficients | None]([None] * BAROMETERS) for finger in fingers}
        self._cells = {row: self.coefficients[finger] for row, finger in zip(rows, fingers, strict=True)}

    @property
    def kind(self) -> type[Touch]:
        """Type of the batches: raw counts."""
        return Touch

    @property
    def fingers(self) -> tuple[int, ...]:
        """Numbers of the fingertips, in the order of their rows."""
        return tuple(self.coefficients)

    async def batches(self, clock: Clock) -> AsyncIterator[Touch]:
        """Yield one sample of each fingertip per scan.

        Raises:
            EndpointError: if the sensor is lost or missing.
        """
        async with aclosing(self._scans(clock)) as scans:
            async for scan in scans:
                times = np.full(len(self.coefficients), scan.time)
                rows = Touch.rows(times, scan.counts, scan.temperature, scan.valid).packed
                for row, finger in enumerate(self.coefficients):
                    yield Touch.unpack(rows[row : row + 1], finger)

    async def diagnose(self, clock: Clock) -> AsyncGenerator[Finding]:
        """Check the bus, the cells of each row, and the rate of the scans.

        If a row is silent, search all 8 rows, which accesses the addresses 0 to 0x3d.

        Raises:
            EndpointError: if the bus cannot be used, or no fingertip answers.
        """
        scans, end = list[Scan](), clock.now() + DIAGNOSIS
        failure: EndpointError | None = None
        try:
            async with aclosing(self._scans(clock)) as received:
                async for scan in received:
                    scans.append(scan)
                    if scan.time > end:
                        break
        except EndpointError as error:
            failure = error
        others: list[int] | None = None
        if not all(any(cells) for cells in self.coefficients.values()):
            others = await asyncio.to_thread(_answering_rows, self.path, clock.now)
        if failure and not others:
            raise failure
        yield Finding(self.path, "opens")
        for index, (row, known) in enumerate(self._cells.items()):
            fault = _row_fault(known, index, scans, others)
            text = fault or f"{BAROMETERS} cells answer"
            yield Finding(f"{self.path} row {row}", text, "bad" if fault else "good")
        if scans:
            time = np.array([scan.time for scan in scans])
            remedy = "use a faster bus (400 kHz), fewer fingertips on the bus or a lower rate; check the load"
            yield rate_finding(self.path, time, self.rate, remedy)

    def _scans(self, clock: Clock) -> AsyncGenerator[Scan]:
        return ScanThread(self.path, self._cells, round(s / self.rate), clock.now).scans()

    @property
    def fingertip(self) -> Fingertip:
        """A TakkTile at the rate of this source."""
        return replace(TAKKTILE, rate=self.rate)

    def describe(self) -> Description:
        """Return sensor, bus, rows and fingertips, and the coefficients once they are read."""
        return {
            "sensor": "TakkTile 2x3",
            "bus": self.path,
            "rows": list(self._cells),
            "fingers": list(self.fingers),
            "coefficients": cast("dict[str, Json]", {str(f): each for f, each in self.coefficients.items()}),
        }


def _answering_rows(path: str, now: Callable[[], int]) -> list[int]:
    """Return the rows of the bus at which a cell answers; none if the bus cannot be used."""
    cells = {row: list[Coefficients | None]([None] * BAROMETERS) for row in range(ROWS)}
    try:
        Scanner(path, cells, now).close()
    except OSError:
        return []
    return [row for row, known in cells.items() if any(known)]


def _row_fault(
    known: Sequence[Coefficients | None], row: int, scans: Sequence[Scan], others: Sequence[int] | None
) -> str:
    """Return what is wrong with the fingertip of a declared row; empty if nothing is.

    `known` are the coefficients of its cells, `row` is its number in the scans, and `others` are all rows
    that answer (None: not searched).
    """
    unknown = [cell for cell, coefficients in enumerate(known) if coefficients is None]
    shares = np.mean([scan.valid[row] for scan in scans] or np.zeros((1, BAROMETERS)), axis=0)  # (6,)
    if silent := [cell for cell in unknown if not shares[cell]]:
        if len(silent) < BAROMETERS:
            return f"cells {_join(silent)} do not answer: check their soldering and cable"
        rows = f"rows {_join(others)} answer: declare them, or program the fingertip" if others else ""
        return f"does not answer; {rows or 'check its power and its row'}"
    if unknown:
        wrong = f"cells {_join(unknown)} have coefficients that no barometer has"
        return f"{wrong}: check the cable and bus speed, or replace the fingertip"
    if scans and (shares < VALID_LEAST).any():
        weak = _join(np.flatnonzero(shares < VALID_LEAST).tolist())
        return f"cells {weak} give implausible values: unload the fingertip, or replace it"
    far = list[str]()
    for cell, coefficients in enumerate(known):
        raw = [(one.counts[row, cell], one.temperature[row, cell]) for one in scans if one.valid[row, cell]]
        if coefficients and raw:
            counts, temperature = np.median(raw, axis=0)
            pressure = coefficients.pressure(float(counts), float(temperature))  # kPa
            far += [f"cell {cell} {pressure:.0f} kPa"] * (not LEAST <= pressure <= MOST)
    if far:
        outside = f"the pressure is outside {LEAST:g} to {MOST:g} kPa: {', '.join(far)}"
        return f"{outside}; unload the fingertip, or replace it"
    return ""


def _join(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers))
