"""A second run with the name of a rig."""

import asyncio
import logging
from pathlib import Path

import pytest

from connectors import Consumer, Mqtt
from connectors.mqtt import broker as module
from connectors.mqtt.broker_link import Link
from operators.ports import Run
from tests.connectors.mqtt.broker_process import TestBroker
from tests.connectors.mqtt.made import slips
from tests.inside import inside
from tests.waiting import until

pytestmark = pytest.mark.broker

RIG = "slip/v1/lab/rig"


async def collect(events: Consumer, found: list[str]) -> None:
    while True:
        found.append((await anext(events)).identifier)


async def test_two_runs_with_one_name_take_turns_name_the_cause_and_lose_nothing(
    broker: TestBroker,
    run: Run,
    links: list[Link],
    tmp_path: Path,
    *,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(module, "BRIEF_PAUSE", 0.3)
    sinks = [Mqtt(broker.url, rig="rig", outbox=tmp_path / name) for name in "ab"]
    found, reports, begun = list[str](), list[str](), asyncio.get_running_loop().time()
    async with Consumer(broker.url, report=reports.append) as events:
        following = asyncio.create_task(collect(events, found))
        for sink in sinks:
            await sink.open(run)
        while len(links) < 8:
            for sink in sinks:
                await sink.write(slips(1))
            await asyncio.sleep(0.02)
        took = asyncio.get_running_loop().time() - begun
        expected = [
            f"{inside(sink, '_outbox').epoch}-{number}"
            for sink in sinks
            for number in range(1, inside(sink, "_outbox", "_newest") + 1)
        ]
        await until(lambda: len(found) >= len(expected))
        for sink in sinks:
            await sink.close()
        following.cancel()
        await asyncio.wait([following])
    assert sorted(found) == sorted(expected)
    assert not reports
    assert len(links) <= 5 + 2 * took / 0.3
    errors = [record.getMessage() for record in caplog.records if record.levelno == logging.ERROR]
    assert errors
    assert all(f"connections of {RIG} end after moments" in each for each in errors)
    assert all("another run has this name, too: give each rig its own" in each for each in errors)
