"""Rehearsal of docs/how-to/backup.md: a running rig is copied, lost, restored, and goes on."""

import asyncio
import subprocess
from collections import Counter
from pathlib import Path
from shutil import rmtree
from typing import Self

import pytest

from connectors import Consumer, Event, Mqtt
from flows.run.clocks import EventClock
from operators.batch import Touch, ms
from operators.ports import Run
from storage import Dataset, Session, verify
from tests.command import slipflow
from tests.connectors.mqtt.broker_process import TestBroker
from tests.connectors.web.reading import slip
from tests.pages import ROOT, block
from tests.waiting import PATIENCE

pytestmark = [pytest.mark.broker, pytest.mark.usefixtures("quiet")]

SCRIPT = block(ROOT / "docs/how-to/backup.md", "backup.sh")


class Rig:
    """A rig that records touch and publishes a slip event per sample."""

    def __init__(self, folder: Path, broker: TestBroker, session: str) -> None:
        self._run = Run(session, "slip", EventClock(0), 0)
        self._mqtt = Mqtt(broker.url, "lab", "ur10", outbox=folder / "outbox")
        self._dataset = Dataset(folder / "recordings")
        self._dataset.part_span = 50 * ms

    async def __aenter__(self) -> Self:
        await self._mqtt.open(self._run)
        await self._dataset.open(self._run)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._dataset.close()
        await self._mqtt.close()

    async def work(self, first: int, end: int) -> None:
        for number in range(first, end):
            time = number * 10 * ms
            await self._dataset.write(Touch.rows([time], [[number] * 6], 0, True, finger=0))
            await self._mqtt.write(slip(time, number % 2))


async def take(events: Consumer, count: int) -> list[Event]:
    async with asyncio.timeout(PATIENCE):
        return [await anext(events) for _ in range(count)]


async def test_a_rig_that_was_copied_while_it_ran_uses_no_number_again_and_no_false_loss_is_reported(
    broker: TestBroker, tmp_path: Path
) -> None:
    rig, archive, reports = tmp_path / "rig", tmp_path / "rig.tar", list[str]()

    def back_up() -> None:
        subprocess.run(["sh", "-c", SCRIPT, "backup.sh", str(rig), str(archive)], check=True)

    def restore() -> None:
        rmtree(rig)
        rig.mkdir()
        subprocess.run(["tar", "-xf", archive, "-C", rig], check=True)

    async with Consumer(broker.url, "lab", "ur10", since="start", report=reports.append) as events:
        async with Rig(rig, broker, "before") as first:
            await first.work(0, 20)
            await asyncio.to_thread(back_up)
            await first.work(20, 40)
        found = await take(events, 40)
        restore()
        repaired = await asyncio.to_thread(slipflow, "verify", rig / "recordings", "--repair")
        assert repaired.returncode == 3, repaired.stdout
        async with Rig(rig, broker, "after") as second:
            await second.work(0, 30)
        found += await take(events, 30)
        async with Rig(rig, broker, "later") as third:  # its first number follows all that was sent again
            await third.work(0, 1)
        found += await take(events, 1)
    assert reports == []
    assert max(Counter((each.epoch, each.seq) for each in found).values()) == 1
    numbers = {epoch: [one.seq for one in found if one.epoch == epoch] for epoch in {e.epoch for e in found}}
    assert sorted(map(len, numbers.values())) == [1, 30, 40]
    assert all(each == list(range(1, len(each) + 1)) for each in numbers.values())
    for name, rows in (("before", 20), ("after", 30)):
        touch = Session.open(rig / "recordings/sessions" / name).frame("touch")
        assert len(touch) >= rows - 10
        assert touch["time"].to_list() == [number * 10 * ms for number in range(len(touch))]
    assert verify(rig / "recordings").code == 3  # repaired; a row that was being written may be cut off
