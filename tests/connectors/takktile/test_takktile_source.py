"""The source on an emulated bus, through an unmodified smbus2, in a real thread, and in flows."""

import asyncio
import json
import logging
import threading
from collections.abc import AsyncGenerator, Iterator
from contextlib import aclosing
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors import TakkTile
from connectors.takktile.scanner import Scan, Scanner, next_scan
from flows.run.clocks import LoopClock
from operators import Clock, EndpointError, Touch, us
from operators.batch import concat
from tests.connectors.takktile.takktile_rig import PATH, Bus
from tests.emulators.i2c_bus import served

SILENT = f"{PATH}: no fingertip answers: check the power and the rows (errno 121)"


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bus]:
    """Yield a bus with the fingers 0, 1 and 2 at rows 0, 1 and 5; check that no thread is left."""
    monkeypatch.setattr("connectors.takktile.scanner.CONVERSION", 100 * us)
    bus = Bus({0: 0, 1: 1, 5: 2})
    with served(bus, PATH):
        yield bus
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
    with pytest.raises(EndpointError) as caught:
        await gather(batches, taken)
    return taken, str(caught.value)


async def gather(batches: AsyncGenerator[Touch], taken: list[Touch]) -> None:
    async for touch in batches:
        taken.append(touch)  # noqa: PERF401 - of what came before an error


@pytest.mark.parametrize(("rows", "fingers"), [((0,), (7,)), ((0, 1, 5), (0, 1, 2))])
async def test_one_or_three_fingertips_are_scanned_100_times_a_second(
    bus: Bus, rows: tuple[int, ...], fingers: tuple[int, ...]
) -> None:
    source, clock = TakkTile(1, rows, fingers=fingers), LoopClock()
    begun = clock.now()
    async with aclosing(stream(source, clock)) as batches:
        taken = await take(batches, 30 * len(rows))
    assert [touch.finger for touch in taken] == [*fingers] * 30
    for index, finger in enumerate(fingers):
        touch = concat(Touch, [each for each in taken if each.finger == finger]).check()
        assert touch.valid.all()
        assert begun < touch.time[0]
        assert (np.diff(touch.time) > 0).all()
        assert touch.time[-1] <= clock.now()
        expected = [bus.skin.pressure(index, row + 1) for row in range(30)]
        np.testing.assert_array_equal(touch.counts, expected)
        assert (touch.temperature == bus.skin.temperature(index)).all()
    assert len({touch.time.item() for touch in taken}) == 30  # all fingertips convert at once


async def test_closing_the_source_disconnects_all_cells_and_ends_its_thread(bus: Bus) -> None:
    async with aclosing(stream(TakkTile(rate=250.0))) as batches:
        await take(batches, 3)
        assert len(threads()) == 1
    assert not threads()
    assert not any(tip.connected for tip in bus.fingertips.values())


async def test_an_unplugged_sensor_fails_and_is_found_again(bus: Bus) -> None:
    source, clock = TakkTile(rate=250.0), LoopClock()
    bus.skin.then[20] = bus.unplug
    taken, why = await lost(stream(source, clock))
    assert why == SILENT
    assert [bool(touch.valid.all()) for touch in taken[:19]] == [True] * 19
    for touch in taken[19:]:  # before it counts as lost; nothing is invented
        assert not touch.valid.any()
        assert not touch.counts.any()

    assert await lost(stream(source, clock)) == ([], SILENT)
    bus.plug()
    async with aclosing(stream(source, clock)) as batches:
        assert (await anext(batches)).valid.all()


@pytest.mark.parametrize("number", [6, 19])
async def test_a_replugged_adapter_is_opened_again(bus: Bus, number: int) -> None:
    source, clock = TakkTile(rate=250.0), LoopClock()
    bus.skin.then[5] = lambda: bus.remove(number)
    _, why = await lost(stream(source, clock))
    assert f"(errno {number})" in why
    async with aclosing(stream(source, clock)) as batches:
        assert (await anext(batches)).valid.all()


async def test_a_hanging_bus_fails_the_source_and_blocks_one_thread_only(
    bus: Bus, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("connectors.takktile.scanner.TIMEOUT", 0.5)
    with caplog.at_level(logging.WARNING):
        source = TakkTile(rate=250.0)
        bus.skin.then[5] = bus.wedge
        taken, why = await lost(stream(source))
        assert 4 <= len(taken) <= 5
        assert "is blocked" in why
        for clock in (LoopClock(), LoopClock()):
            assert "reset a blocked adapter" in (await lost(stream(source, clock)))[1]
            assert len(threads()) == 1
        [blocked] = threads()
        bus.release()
        await asyncio.to_thread(blocked.join, 10.0)
        async with aclosing(stream(source, clock)) as batches:
            assert (await anext(batches)).valid.all()
    assert [record.message for record in caplog.records] == ["/dev/i2c-1: abandoned a blocked thread"]


async def test_scans_beyond_the_backlog_are_missed(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("connectors.takktile.scanner.BACKLOG", 5)
    source = TakkTile(rate=300.0)
    async with aclosing(stream(source)) as batches:
        await anext(batches)
        await asyncio.sleep(0.5)
        time = [touch.time.item() for touch in await take(batches, 6)]
    assert time[4] - time[0] < time[5] - time[4]


async def test_an_error_of_a_program_follows_older_scans(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: Scanner) -> Scan:
        monkeypatch.undo()
        raise ZeroDivisionError("oh")

    bus.skin.then[3] = lambda: monkeypatch.setattr(Scanner, "scan", broken)
    taken = list[Touch]()
    with pytest.raises(ZeroDivisionError, match="oh"):  # no failure of the device: not retried
        await gather(stream(TakkTile()), taken)
    assert len(taken) == 3


def test_a_thread_without_its_loop_ends(bus: Bus) -> None:  # which the fixture checks
    async def main() -> AsyncGenerator[Touch]:
        batches = stream(TakkTile())
        await anext(batches)
        return batches

    loop = asyncio.new_event_loop()
    loop.run_until_complete(main())
    loop.close()
    assert threads()


@given(st.integers(0, 10**12), st.integers(0, 10**10), st.integers(1, 10**9))
def test_the_schedule_skips_and_never_drifts(due: int, took: int, period: int) -> None:
    then = next_scan(due, due + took, period)
    missed = (then - due) // period - 1
    assert then - due == (1 + missed) * period
    assert missed >= 0
    assert then > due + took - period  # it can still begin within its own period
    assert missed == 0 or then <= due + took  # none is missed without need


async def test_the_description_is_live_and_plain_data(bus: Bus) -> None:
    source = TakkTile(1, (0, 5), fingers=(0, 4), rate=250.0)
    described = source.describe()
    before = json.loads(json.dumps(dict(described)))
    assert before["coefficients"] == {"0": [None] * 6, "4": [None] * 6}
    assert (before["bus"], before["rows"], source.fingertip.rate) == (PATH, [0, 5], 250.0)
    async with aclosing(stream(source)) as batches:
        await take(batches, 10)
    after = json.loads(json.dumps(dict(described)))
    assert after["coefficients"]["4"][1] == pytest.approx([2010.75, -2.37585, -0.92047, 7.9012e-4], rel=1e-4)
