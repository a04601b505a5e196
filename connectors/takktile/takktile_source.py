"""TakkTile fingertips on an I2C bus as a live source."""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing
from pathlib import Path
from typing import Final, cast

import numpy as np

from connectors.takktile.i2c_access import I2cBus, LinuxI2cBus
from connectors.takktile.scan_thread import ScanThread, Schedule
from connectors.takktile.takktile_protocol import ROWS, Coefficients, compensate
from connectors.takktile.takktile_scan import Scan
from operators.batch import BAROMETERS, Reals, Touch, Zeroed, ms, s
from operators.errors import EndpointError, ParameterError
from operators.ports import Clock, Description, Json, Source

LOOK_AGAIN: Final = 0.25  # s, between attempts to find a sensor that is lost
FASTEST: Final = ms // 10  # ns, of a conversion, far below any; what is shorter was not meant in ns
ADAPTERS: Final = Path("/sys/class/i2c-dev")


class TakkTile(Source[Touch]):
    """Fingertips of six barometers each, scanned together in a thread of their own.

    All barometers convert at once; the stamp is the instant at which they start. A cell is valid if it
    answered what a working cell can convert; what is not valid is given as received, or as 0. A scan that is
    late moves no other, and one that is missed is not made up for.

    When no cell has answered for 0.25 s the sensor is lost. The source fails once, so that the runner
    records the gap, and then looks for it by itself every 0.25 s. The bus is locked against other programs
    that scan it.

    Args:
        bus: Number of the I2C bus (1 for /dev/i2c-1), its path, or a bus object such as a virtual lab's.
        rows: Of the fingertips, as their ATtinys are programmed: 0 to 7.
        fingers: What the fingertips are called in the flow; by default 0, 1 and so on.
        rate: Scans per second.
        conversion: Wait for a conversion, ns. The datasheet says 3 ms at most, TakkTile's own code waits 1.6.

    Attributes:
        path: The bus.
        coefficients: By finger, of its six cells; None of a cell that has not answered yet.

    Raises:
        ParameterError: on a value that cannot be used.

    >>> takktile = TakkTile(bus=1, rows=(0, 2))
    >>> takktile.path, takktile.fingers
    ('/dev/i2c-1', (0, 1))
    """

    def __init__(
        self,
        bus: int | str | I2cBus = 1,
        rows: tuple[int, ...] = (0,),
        *,
        fingers: tuple[int, ...] | None = None,
        rate: float = 100.0,
        conversion: int = 3 * ms,
    ) -> None:
        if not isinstance(cast("object", rows), tuple):  # the caller may not be type-checked
            raise ParameterError("TakkTile", "rows", rows, "a tuple, such as (0,)")
        if bus == "" or (isinstance(bus, int) and bus < 0):
            raise ParameterError("TakkTile", "bus", bus, "the number of a bus, 0 or above, or its path")
        fingers = tuple(range(len(rows))) if fingers is None else fingers
        if not rows or len(set(rows)) != len(rows) or not set(rows) <= set(range(ROWS)):
            raise ParameterError("TakkTile", "rows", rows, f"different ones, from 0 to {ROWS - 1}")
        if not len(fingers) == len(set(fingers)) == len(rows) or min(fingers) < 0:
            raise ParameterError("TakkTile", "fingers", fingers, "different numbers, one for each row")
        if not rate > 0:
            raise ParameterError("TakkTile", "rate", rate, "above 0 Hz")
        if not FASTEST <= conversion < s / rate:
            must_be = f"from {FASTEST} ns to less than {s / rate:.0f} ns, such as 3 * ms"
            raise ParameterError("TakkTile", "conversion", conversion, must_be)
        if isinstance(bus, int | str):
            bus = LinuxI2cBus(f"/dev/i2c-{bus}" if isinstance(bus, int) else bus)
        self.path = bus.path
        self.rate = rate
        self.coefficients = {finger: list[Coefficients | None]([None] * BAROMETERS) for finger in fingers}
        self._fingers = fingers
        self._counted: dict[str, int] = {"made": 0, "silent": 0, "late": 0, "missed": 0}  # scans
        self._schedule = Schedule(bus, rows, conversion, round(s / rate), self._counted)
        self._learnt = {str(finger): list[Json]([None] * BAROMETERS) for finger in fingers}  # as plain data
        self._thread: ScanThread | None = None  # the newest
        self._told: Clock | None = None  # of the run that knows that the sensor is lost

    @property
    def kind(self) -> type[Touch]:
        """Raw counts."""
        return Touch

    @property
    def fingers(self) -> tuple[int, ...]:
        """The fingertips, in the order of their rows."""
        return self._fingers

    async def batches(self, clock: Clock) -> AsyncIterator[Touch]:
        """One sample of each fingertip in turn, per scan.

        Raises:
            EndpointError: when the sensor is lost, or not there; once in a run, until it has been back.
        """
        while True:
            try:
                async with aclosing(self._connection(clock)) as scans:
                    async for scan in scans:
                        self._told = None
                        for row, finger in enumerate(self._fingers):
                            one = slice(row, row + 1)
                            yield Touch(
                                np.array([scan.time]),
                                scan.counts[one],
                                scan.temperature[one],
                                scan.valid[one],
                                finger=finger,
                            )
            except EndpointError:
                if self._told is not clock:
                    self._told = clock
                    raise
            await asyncio.sleep(LOOK_AGAIN)

    async def _connection(self, clock: Clock) -> AsyncGenerator[Scan]:
        """The scans of a sensor that is there, until it is lost."""
        if self._thread is not None and self._thread.alive:
            raise EndpointError(self.path, "is still blocked: reset its adapter, or restart the machine")
        self._thread = thread = ScanThread(self._schedule, clock.now, self._learn)
        try:
            async with aclosing(thread.scans()) as scans:
                async for scan in scans:
                    yield scan
        finally:
            await thread.end()

    def pressure(self, touch: Touch) -> Reals:
        """Absolute pressure (kPa) at the cells, (n, 6), of a fingertip's raw counts.

        NaN where a reading is not valid, or its cell has not told its coefficients yet.

        Raises:
            ParameterError: if the counts are not raw, or of another finger.
        """
        if isinstance(touch, Zeroed):
            raise ParameterError("TakkTile", "touch", type(touch).__name__, "raw counts, a Touch")
        if touch.finger not in self.coefficients:
            raise ParameterError("TakkTile", "finger", touch.finger, f"one of {self._fingers}")
        pressure = compensate(touch.counts, touch.temperature, self.coefficients[touch.finger])
        return np.where(touch.valid, pressure, np.nan)

    def describe(self) -> Description:
        """Sensor, bus, schedule; ``coefficients`` and ``scans`` are alive: read them at the end.

        ``scans`` counts since the source was made: made, of these silent (nobody answered) and late (by more
        than a tenth of the period), and missed.
        """
        schedule = self._schedule
        return {
            "sensor": "TakkTile 2x3",
            "bus": self.path,
            **_adapter(self.path),
            "rows": list(schedule.rows),
            "fingers": list(self._fingers),
            "rate_hz": self.rate,
            "conversion_ms": schedule.conversion / ms,
            "coefficients": cast("dict[str, Json]", self._learnt),
            "scans": cast("dict[str, Json]", self._counted),
        }

    def _learn(self, fingertip: int, cell: int, coefficients: Coefficients | None) -> None:
        """Remember what a cell says of itself."""
        finger = self._fingers[fingertip]
        self.coefficients[finger][cell] = coefficients
        self._learnt[str(finger)][cell] = None if coefficients is None else list(coefficients)


def _adapter(path: str) -> dict[str, Json]:
    """What Linux knows of an adapter: its name, and the speed it was told to have."""
    folder = ADAPTERS / Path(path).name
    about: dict[str, Json] = {"adapter": None, "bus_hz": None}
    try:
        about["adapter"] = (folder / "name").read_text().strip()
        about["bus_hz"] = int.from_bytes((folder / "device/of_node/clock-frequency").read_bytes(), "big")
    except OSError:  # no such bus, or one that says less
        pass
    return about
