"""Loggers at real serial ports (pseudo-terminals), read through an unmodified pyserial."""

import asyncio
import os
import pty
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from connectors import LineSource
from flows.run.clocks import LoopClock
from flows.run.diagnosis import diagnose
from operators.ports import Finding
from tests.connectors.files.test_line_source import MAP, NAMES, Reader, first_cells, text
from tests.waiting import PATIENCE

pytest.importorskip("serial_asyncio_fast")


class Logger:
    """Logger at a serial port, which can be unplugged and keeps its name."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.plug()

    def plug(self) -> None:
        self._master, self._slave = pty.openpty()
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._slave))

    def unplug(self) -> None:
        os.close(self._slave)
        os.close(self._master)

    def send(self, data: str) -> None:
        os.write(self._master, data.encode())


@pytest.fixture
def port(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Logger]:
    path = tmp_path / "ttyACM0"
    monkeypatch.setattr("connectors.files.line_source._is_port", lambda where: where == str(path))
    logger = Logger(path)
    yield logger
    logger.unplug()


async def until(condition: Callable[[], object], again: Callable[[], object] = lambda: None) -> None:
    """Wait for a condition; do something again meanwhile."""
    async with asyncio.timeout(PATIENCE):
        while not condition():
            again()
            await asyncio.sleep(0.05)


async def test_a_port_is_read_from_any_byte_on_and_found_again(port: Logger) -> None:
    reader = Reader(LineSource(port.path, MAP))
    await until(lambda: reader.counts["damaged"] > 2, lambda: port.send(text([8])))  # no names yet
    damaged = reader.counts["damaged"]
    port.send(f"{NAMES}\r\n" + text(range(5)) + "50")
    await until(lambda: len(first_cells(reader.batches)) >= 5)
    assert first_cells(reader.batches) == [0, 1, 2, 3, 4]
    assert reader.counts["damaged"] - damaged in (0, 1)
    port.unplug()
    await until(lambda: reader.errors)
    assert "unplugged" in reader.errors[0]
    port.plug()
    await until(
        lambda: first_cells(reader.batches)[-2:] == [20, 21],
        lambda: port.send(f"{NAMES}\r\n" + text(range(20, 22))),
    )
    reader.task.cancel()


async def test_a_port_is_used_by_one_program(port: Logger) -> None:
    reader, other = Reader(LineSource(port.path, MAP)), Reader(LineSource(port.path, MAP))
    await until(lambda: reader.errors or other.errors)
    assert {*reader.errors, *other.errors} == {"is in use: end the other program"}
    reader.task.cancel()
    other.task.cancel()


async def checked(source: LineSource, send: Callable[[int], object]) -> list[Finding]:
    async def write() -> None:
        loop = asyncio.get_running_loop()
        begin = loop.time()
        for row in range(100_000):
            send(row)
            await asyncio.sleep(begin + row / 100 - loop.time())

    writing = asyncio.create_task(write())
    found = (await diagnose({"touch": source}, LoopClock()))["touch"]
    writing.cancel()
    return found


async def test_doctor_checks_lines_and_rate(port: Logger, tmp_path: Path) -> None:
    names = NAMES.split(",")
    good = await checked(LineSource(port.path, MAP, names=names), lambda row: port.send(text([row])))
    assert [each.state for each in good] == ["good", "good"]
    assert " lines, 0 damaged" in good[0].text or " lines, 1 damaged" in good[0].text  # the first may be cut
    slow = LineSource(port.path, replace(MAP, rate=50.0), names=names)
    found = (await checked(slow, lambda row: port.send(text([row]))))[1]
    assert found.state == "bad"
    assert found.text.endswith(
        "rows per second of 50: correct the rate in the map, or the rate of the logger"
    )
    [silent] = await checked(LineSource(port.path, MAP), lambda _: None)
    assert silent.text == "sent no line for 3 s: is the logger on, is 115200 its baud rate?"
    [missing] = await checked(LineSource(tmp_path / "none.csv", MAP), lambda _: None)
    assert (missing.state, missing.text.split(":")[0]) == ("bad", "does not exist")
