import asyncio
import threading
from collections.abc import AsyncGenerator, Iterator
from contextlib import aclosing
from time import time_ns

import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.takktile.scanner import Scan, Scanner, ScanThread, Schedule, next_scan
from connectors.takktile.takktile_protocol import Coefficients
from operators import ms, us
from tests.emulators.i2c_bus import EmulatedI2cBus, Still, served

PATH = "/dev/i2c-1"


class Counted(dict[str, int]):
    """Counts of scans; `enough` is set after ten missed scans in a row."""

    def __init__(self) -> None:
        super().__init__(made=0, silent=0, late=0, missed=0)
        self.enough = threading.Event()
        self._before, self._again = 0, 0

    def __setitem__(self, name: str, value: int) -> None:
        super().__setitem__(name, value)
        if name == "made":
            self._again = 0
        elif name == "missed" and value > self._before:
            self._before, self._again = value, self._again + 1
            if self._again >= 10:
                self.enough.set()


@pytest.fixture(autouse=True)
def bus(monkeypatch: pytest.MonkeyPatch) -> Iterator[EmulatedI2cBus]:
    monkeypatch.setattr("connectors.takktile.scanner.CONVERSION", 100 * us)
    with served(EmulatedI2cBus(Still(), conversion=50 * us), PATH) as bus:
        yield bus


def begin(counted: Counted) -> ScanThread:
    """Return a thread that scans 500 times per second."""

    cells: list[list[Coefficients | None]] = [[None] * 6]
    return ScanThread(Schedule(PATH, (0,), 2 * ms, counted, cells), time_ns)


@given(st.integers(0, 10**12), st.integers(0, 10**10), st.integers(1, 10**9))
def test_the_schedule_skips_and_never_drifts(due: int, took: int, period: int) -> None:
    then, missed = next_scan(due, due + took, period)
    assert then - due == (1 + missed) * period
    assert missed >= 0
    assert then > due + took - period  # it can still begin within its own period
    assert missed == 0 or then <= due + took  # none is missed without need


def test_scans_beyond_the_backlog_are_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("connectors.takktile.scanner.BACKLOG", 5)

    async def main() -> None:
        counted = Counted()
        async with aclosing(begin(counted).scans()) as scans:
            await anext(scans)
            assert await asyncio.to_thread(counted.enough.wait, 30.0)
            assert counted["made"] == 6

    asyncio.run(main())


def test_the_error_of_a_thread_comes_after_its_scans(monkeypatch: pytest.MonkeyPatch) -> None:
    made, scan = list[Scan](), Scanner.scan

    def broken(scanner: Scanner) -> Scan:
        if len(made) == 3:
            raise ZeroDivisionError("oh")
        made.append(scan(scanner))
        return made[-1]

    monkeypatch.setattr(Scanner, "scan", broken)

    async def main() -> None:
        taken = list[Scan]()

        async def gather() -> None:
            async for each in begin(Counted()).scans():
                taken.append(each)

        with pytest.raises(ZeroDivisionError, match="oh"):  # no failure of the device: not retried
            await gather()
        assert [each.time for each in taken] == [each.time for each in made]

    asyncio.run(main())


def test_a_thread_without_its_loop_ends() -> None:
    async def main() -> AsyncGenerator[Scan]:
        scans = begin(Counted()).scans()
        await anext(scans)
        return scans

    loop = asyncio.new_event_loop()
    loop.run_until_complete(main())
    loop.close()
    for thread in threading.enumerate():
        if thread.name.startswith("takktile"):
            thread.join(30.0)
            assert not thread.is_alive()
