"""The source on an emulated bus, through an unmodified smbus2, in a real thread, and in flows."""

import asyncio
import json
import logging
import threading
from collections.abc import AsyncGenerator, Callable, Iterator
from contextlib import aclosing
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from connectors import TakkTile
from flows.run.clocks import LoopClock
from operators import Clock, EndpointError, ParameterError, Touch, us
from operators.batch import Counts, concat
from tests.emulators.i2c_bus import EmulatedI2cBus, served

PATH = "/dev/i2c-1"
SILENT = f"{PATH}: no fingertip answers: check the power and the rows (errno 121)"


class Skin:
    """Counts that depend on finger and cell; functions can be called at given conversions."""

    def __init__(self) -> None:
        self.conversions = 0
        self.then: dict[int, Callable[[], None]] = {}  # by number of the conversion
        self._time = 0

    def touch(self, finger: int, time: int) -> tuple[Counts, Counts]:
        if time != self._time:
            self._time, self.conversions = time, self.conversions + 1
            if happen := self.then.get(self.conversions):
                happen()
        return pressure(finger), np.full(6, 507, np.int16)


def pressure(finger: int) -> Counts:
    return (400 + 10 * finger + np.arange(6)).astype(np.int16)


class Rig:
    """Bus with the fingers 0, 1 and 2 at rows 0, 1 and 5."""

    def __init__(self) -> None:
        self.skin = Skin()
        self.bus = EmulatedI2cBus(self.skin, {0: 0, 1: 1, 5: 2}, conversion=200 * us)

    def source(
        self,
        rows: tuple[int, ...] = (0,),
        fingers: tuple[int, ...] | None = None,
        rate: float = 250.0,
    ) -> TakkTile:
        return TakkTile(1, rows, fingers=fingers, rate=rate)


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
    """Yield a bus with short conversions; check that no thread is left."""
    monkeypatch.setattr("connectors.takktile.scanner.CONVERSION", 300 * us)
    rig = Rig()
    with served(rig.bus, PATH):
        yield rig
    for thread in threads():
        thread.join(10.0)
    assert not threads()


def threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name.startswith("takktile")]


def stream(source: TakkTile, clock: Clock | None = None) -> AsyncGenerator[Touch]:
    return cast("AsyncGenerator[Touch]", source.batches(clock or LoopClock()))


async def take(batches: AsyncGenerator[Touch], count: int) -> list[Touch]:
    return [await anext(batches) for _ in range(count)]


async def lost(batches: AsyncGenerator[Touch]) -> tuple[list[Touch], str]:
    """Return the batches of a source until it fails, and the error."""
    taken = list[Touch]()
    try:
        async for touch in batches:
            taken.append(touch)
    except EndpointError as error:
        return taken, str(error)
    raise AssertionError("it ended")


def counted(source: TakkTile) -> dict[str, int]:
    return cast("dict[str, int]", source.describe()["scans"])


@pytest.mark.parametrize(("rows", "fingers"), [((0,), (7,)), ((0, 1, 5), (0, 1, 2))])
async def test_one_or_three_fingertips_are_scanned_100_times_a_second(
    rig: Rig, rows: tuple[int, ...], fingers: tuple[int, ...]
) -> None:
    source, clock = rig.source(rows=rows, fingers=fingers, rate=100.0), LoopClock()
    begun = clock.now()
    async with aclosing(stream(source, clock)) as batches:
        taken = await take(batches, 30 * len(rows))
    assert [touch.finger for touch in taken] == [*fingers] * 30
    for finger, is_ in zip(fingers, range(3), strict=False):
        touch = concat(Touch, [each for each in taken if each.finger == finger]).check()
        assert touch.valid.all()
        assert begun < touch.time[0]
        assert (np.diff(touch.time) > 0).all()
        assert touch.time[-1] <= clock.now()
        assert (touch.counts == pressure(is_)).all()
        assert (touch.temperature == 507).all()
    assert len({touch.time.item() for touch in taken}) == 30  # all fingertips convert at once


async def test_closing_the_source_disconnects_all_cells_and_ends_its_thread(rig: Rig) -> None:
    async with aclosing(stream(rig.source())) as batches:
        await take(batches, 3)
        assert len(threads()) == 1
    assert not threads()
    assert not any(tip.connected for tip in rig.bus.fingertips.values())


async def test_an_unplugged_sensor_fails_and_is_found_again(rig: Rig) -> None:
    source, clock = rig.source(), LoopClock()
    rig.skin.then[20] = rig.bus.unplug
    taken, why = await lost(stream(source, clock))
    assert why == SILENT
    assert [bool(touch.valid.all()) for touch in taken[:19]] == [True] * 19
    for touch in taken[19:]:  # before it counts as lost; nothing is invented
        assert not touch.valid.any()
        assert not touch.counts.any()
    assert counted(source)["silent"] >= len(taken[19:])

    assert await lost(stream(source, clock)) == ([], SILENT)
    rig.bus.plug()
    async with aclosing(stream(source, clock)) as batches:
        assert (await anext(batches)).valid.all()


@pytest.mark.parametrize("number", [6, 19])
async def test_a_replugged_adapter_is_opened_again(rig: Rig, number: int) -> None:
    source, clock = rig.source(), LoopClock()
    rig.skin.then[5] = lambda: rig.bus.remove(number)
    _, why = await lost(stream(source, clock))
    assert f"(errno {number})" in why
    rig.bus.restore()
    async with aclosing(stream(source, clock)) as batches:
        assert (await anext(batches)).valid.all()


async def test_a_hanging_bus_fails_the_source_and_blocks_one_thread_only(
    rig: Rig, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("connectors.takktile.scanner.TIMEOUT", 0.5)
    with caplog.at_level(logging.WARNING):
        source = rig.source()
        rig.skin.then[5] = rig.bus.wedge
        taken, why = await lost(stream(source))
        assert 4 <= len(taken) <= 5
        assert "is blocked" in why
        for clock in (LoopClock(), LoopClock()):
            assert "reset a blocked adapter" in (await lost(stream(source, clock)))[1]
            assert len(threads()) == 1
        [blocked] = threads()
        rig.bus.release()
        await asyncio.to_thread(blocked.join, 10.0)
        async with aclosing(stream(source, clock)) as batches:
            assert (await anext(batches)).valid.all()
    assert [record.message for record in caplog.records] == ["/dev/i2c-1: abandoned a blocked thread"]


async def test_the_description_is_live_and_plain_data(rig: Rig) -> None:
    source = rig.source(rows=(0, 5), fingers=(0, 4))
    described = source.describe()
    before = json.loads(json.dumps(dict(described)))
    assert before["coefficients"] == {"0": [None] * 6, "4": [None] * 6}
    assert before["scans"] == {"made": 0, "silent": 0, "late": 0, "missed": 0}
    assert (before["bus"], before["rows"], source.fingertip.rate) == (PATH, [0, 5], 250.0)
    async with aclosing(stream(source)) as batches:
        await take(batches, 10)
    after = json.loads(json.dumps(dict(described)))
    assert after["coefficients"]["4"][1] == pytest.approx([2010.75, -2.37585, -0.92047, 7.9012e-4], rel=1e-4)
    assert after["scans"]["made"] >= 5


def test_the_linux_adapter_is_described(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("connectors.takktile.takktile_source.ADAPTERS", tmp_path)
    assert TakkTile().describe()["adapter"] is None
    (tmp_path / "i2c-1/device/of_node").mkdir(parents=True)
    (tmp_path / "i2c-1/name").write_text("bcm2835 (i2c@7e804000)\n")
    assert TakkTile().describe()["adapter"] == "bcm2835 (i2c@7e804000)"
    (tmp_path / "i2c-1/device/of_node/clock-frequency").write_bytes((400_000).to_bytes(4, "big"))
    assert TakkTile().describe()["bus_hz"] == 400_000


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("rows", {"rows": ()}),
        ("rows", {"rows": (0, 0)}),
        ("rows", {"rows": (8,)}),
        ("fingers", {"fingers": (0, 1)}),
        ("fingers", {"rows": (0, 1), "fingers": (2, 2)}),
        ("fingers", {"fingers": (-1,)}),
        ("rate", {"rate": 0.0}),
        ("rows", {"rows": 0}),
        ("bus", {"bus": -1}),
        ("bus", {"bus": ""}),
        ("rate", {"rate": 334.0}),
    ],
)
def test_bad_parameters_are_refused(name: str, changes: dict[str, Any]) -> None:
    with pytest.raises(ParameterError, match=name):
        TakkTile(**changes)


def test_a_bus_is_given_by_number_or_path() -> None:
    assert TakkTile(bus=3).path == "/dev/i2c-3"
    assert TakkTile(bus="/dev/i2c-fingers").path == "/dev/i2c-fingers"
