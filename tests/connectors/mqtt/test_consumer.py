import asyncio
import re
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from msgspec.structs import replace

from connectors import Consumer, Event, Mqtt
from connectors.mqtt import broker_link as link
from connectors.mqtt.broker import Message
from connectors.mqtt.broker_link import Link
from operators.errors import EndpointError
from operators.ports import Run
from tests.connectors.mqtt.broker_process import TestBroker
from tests.connectors.mqtt.made import EVENT, opened, slips
from tests.inside import inside
from tests.waiting import PATIENCE, until

pytestmark = [pytest.mark.broker, pytest.mark.usefixtures("quiet")]

UR10 = "slip/v1/lab/ur10"
REFUSED = "cannot connect: Connection refused; check that the broker runs and that this is its port"


def event(seq: int, rig: str = "ur10") -> Event:
    return replace(EVENT, seq=seq, rig=rig)


def publish(broker: TestBroker, seq: int, rig: str = "ur10", *options: str) -> Event:
    broker.publish(f"slip/v1/lab/{rig}/0/event", event(seq, rig).encode().decode(), *options)
    return event(seq, rig)


async def following(events: Consumer) -> None:
    """Let it wait for an event that does not come, until it has what the broker retains."""
    coming = asyncio.create_task(anext(events))
    await until(lambda: bool(inside(events, "_position", "_rigs")))
    coming.cancel()
    await asyncio.wait([coming])


async def take(events: Consumer, count: int) -> list[int]:
    async with asyncio.timeout(PATIENCE):
        return [(await anext(events)).seq for _ in range(count)]


async def test_malformed_messages_are_reported_in_one_line_and_ignored(broker: TestBroker) -> None:
    reports = list[str]()
    bad = [
        ("0/event", "{}"),
        ("1/event", "no\njson"),
        ("2/event", EVENT.encode().decode()),
        ("3/event", "x" * 100_000),
        ("4/event", replace(EVENT, finger="4", epoch="e" * 65).encode().decode()),
        ("head", '{"epoch": 7}'),
    ]
    for place, payload in bad:
        broker.publish(f"{UR10}/{place}", payload, "-r")
    for rig in ("", "n" * (2**16 - len("slip/v1/lab//head") - 1)):  # requests to the latter would be too long
        broker.publish(f"slip/v1/lab/{rig}/head", '{"epoch": "q", "last_seq": 9}', "-r")
        bad.append((rig, "no name of a rig"))
    async with Consumer(broker.url, since="start", report=reports.append) as events:
        await until(lambda: len(inside(events, "_link", "_received")) == len(bad))
        publish(broker, 1)
        assert await take(events, 1) == [1]
    assert len(reports) == len(bad)
    assert all(
        re.match("ignoring malformed message: '?slip/", each) and each.isprintable() for each in reports
    )
    assert {
        f"ignoring malformed message: {UR10}/0/event: Object missing required field `specversion`",
        f"ignoring malformed message: {UR10}/2/event: has an event of lab/ur10/0",
        f"ignoring malformed message: {UR10}/3/event: is 100000 bytes long; the limit is 65536",
    } < {*reports}


async def test_dropped_messages_are_reported_and_their_events_fetched(
    broker: TestBroker, run: Run, links: list[Link], monkeypatch: pytest.MonkeyPatch
) -> None:
    reports = list[str]()
    async with opened(Mqtt(broker.url, "lab", "ur10"), run) as sink:
        monkeypatch.setattr(link, "INCOMING_MAX", 8)
        async with Consumer(broker.url, report=reports.append) as events:
            await following(events)
            await sink.write(slips(*[1, 0] * 20))
            await until(lambda: links[1].dropped > 20)
            assert sorted(await take(events, 40)) == list(range(1, 41))
    assert reports
    assert all("the consumer is behind: " in report for report in reports)


async def test_an_unwritable_position_is_named_and_written_later(broker: TestBroker, tmp_path: Path) -> None:
    reports, folder = list[str](), tmp_path / "there"
    folder.mkdir()
    async with Consumer(broker.url, position_file=folder / "position", report=reports.append) as events:
        shutil.rmtree(folder)
        publish(broker, 1)
        publish(broker, 2)
        assert await take(events, 2) == [1, 2]
        await until(lambda: bool(reports))
        publish(broker, 3)
        assert await take(events, 1) == [3]
        await until(lambda: inside(events, "_saving").done)
        folder.mkdir()
    assert (folder / "position").exists()
    assert reports == [f"{folder}/position: cannot be written: No such file or directory"]


async def test_a_refused_request_for_missed_events_is_reported_once(tmp_path: Path) -> None:
    rights, reports = tmp_path / "rights", list[str]()
    rights.write_text("topic read #\ntopic write slip/v1/+/+/head\n")
    with TestBroker(tmp_path, "allow_anonymous true", f"acl_file {rights}") as broker:
        for rig in ("ur10", "ur5"):
            broker.publish(f"slip/v1/lab/{rig}/head", '{"epoch": "ab", "last_seq": 3}', "-r")
        async with Consumer(broker.url, since="start", report=reports.append) as events:
            await following(events)
            await until(lambda: not inside(events, "_link", "_answers"))
    [report] = reports
    refused = rf"{broker.url}: refuses to publish slip/v1/lab/ur\d+/replay/request: Not authorized; "
    assert re.fullmatch(f"{refused}allow it in .*; missed events cannot be fetched", report)


async def test_each_new_reason_why_a_consumer_cannot_reconnect_is_reported(
    broker: TestBroker, monkeypatch: pytest.MonkeyPatch
) -> None:
    reports, failures, connect = list[str](), ["refused", "refused", "certificate has expired"], link.connect

    async def fail(*about: Any) -> Link:
        if failures:
            raise EndpointError(broker.url, failures.pop(0))
        return await connect(*about)

    async with Consumer(broker.url, report=reports.append) as events:
        monkeypatch.setattr(link, "connect", fail)
        await vars(Consumer)["_disconnect"](events)
        await vars(Consumer)["_reconnect"](events)
    expected = "refused, reconnecting", "certificate has expired, reconnecting", "connected again"
    assert reports == [f"{broker.url}: {each}" for each in expected]


async def test_one_consumer_at_a_time_can_use_a_position_file(
    broker: TestBroker, tmp_path: Path, links: list[Link]
) -> None:
    for _ in range(2):
        async with Consumer(broker.url, position_file=tmp_path / "position"):
            with pytest.raises(EndpointError, match="is in use by another consumer"):
                async with Consumer(broker.url, position_file=tmp_path / "position"):
                    pass
            assert len(links) % 2 == 1  # the second did not connect
        links.append(links[0])
    broker.stop()
    for _ in range(2):  # an attempt that failed lets go, too
        with pytest.raises(EndpointError, match=rf"^{broker.url}: {REFUSED}$"):
            async with Consumer(broker.url, position_file=tmp_path / "position"):
                pass


async def test_a_check_asks_at_most_100_rigs_and_the_next_one_asks_others() -> None:
    events, posted = Consumer("mqtt://localhost", since="start"), list[Message]()

    def publish(message: Message) -> asyncio.Future[str]:
        posted.append(message)
        return asyncio.Future()

    for number in range(300):
        inside(events, "_position").announce(("lab", f"forged{number}"), {"ab": 9})
        if number == 100:
            inside(events, "_position").take(event(3))
    for checks in range(1, 5):
        vars(Consumer)["_check"](events, SimpleNamespace(publish=publish))
        assert len({message.topic for message in posted}) == len(posted) == min(100 * checks, 301)
    assert f"{UR10}/replay/request" in {message.topic for message in posted}
