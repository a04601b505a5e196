"""Other clients of a broker: a second run with the name of a rig, and clients that are broken or hostile."""

import asyncio
import json
import logging
from pathlib import Path

import pytest

from connectors import Consumer, Mqtt
from connectors.mqtt import broker as module
from connectors.mqtt import consumer
from connectors.mqtt.broker import Broker, Message
from connectors.mqtt.broker_link import Link, connect
from connectors.mqtt.gap_replay import GapRequest
from operators.ports import Run
from storage.files import put
from tests.connectors.mqtt.broker_process import TestBroker
from tests.connectors.mqtt.made import slips
from tests.inside import inside
from tests.waiting import until

pytestmark = pytest.mark.broker

RIG = "slip/v1/lab/rig"


async def slip(sink: Mqtt, count: int = 1) -> None:
    await sink.write(slips(*[1] * count))


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
                await slip(sink)
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


@pytest.mark.usefixtures("quiet")
async def test_forged_heads_requests_and_topics_neither_lose_an_event_nor_report_a_loss(
    broker: TestBroker, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, reports, saves = list[str](), list[str](), list[int]()

    def noting(path: Path, payload: bytes) -> None:
        saves.append(len(payload))
        put(path, payload)

    monkeypatch.setattr(consumer, "put", noting)
    sink = Mqtt(broker.url, rig="rig")
    await sink.open(run)
    await slip(sink, 200)
    await until(lambda: not sink.waiting)
    epoch = inside(sink, "_outbox").epoch
    begun = asyncio.get_running_loop().time()
    attacker = await connect(Broker.parse(broker.url), "attacker")
    async with Consumer(broker.url, position_file=tmp_path / "position", report=reports.append) as events:
        following = asyncio.create_task(collect(events, found))
        await until(lambda: ("lab", "rig") in inside(events, "_position").rigs)
        for number in range(300):
            before = [{"epoch": f"e{number}-{each}", "last_seq": 9} for each in range(99)]
            head = json.dumps({"epoch": "z", "last_seq": number, "before": before}).encode()
            asked = GapRequest(epoch, 1, 200, f"{RIG}/replay/{number}").encode()
            topics = f"slip/v1/lab/rig{number}/head", "slip/v1//rig/head"
            forged = [Message(topic, head) for topic in topics[: 1 + (number < 3)]]
            await attacker.send_all([*forged, Message(f"{RIG}/replay/request", asked, retain=False)])
            await slip(sink)
        await until(lambda: len(found) == 300)
        following.cancel()
        await asyncio.wait([following])
        assert len(inside(events, "_position").rigs) <= 100
    took = asyncio.get_running_loop().time() - begun
    assert sum(size > consumer.LARGE for size in saves) <= 2 + took / consumer.SAVE_EVERY
    await attacker.disconnect()
    await sink.close()
    assert found == [f"{epoch}-{number}" for number in range(201, 501)]
    assert reports == [reports[0]] * 3
    assert reports[0].startswith("ignoring malformed message: 'slip/v1//rig/head': site and rig")
