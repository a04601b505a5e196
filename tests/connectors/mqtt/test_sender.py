import asyncio
import logging
from collections.abc import AsyncGenerator, Iterable, Iterator
from contextlib import asynccontextmanager
from itertools import count, pairwise
from pathlib import Path
from random import Random
from typing import Any

import pytest
from msgspec.structs import replace

from connectors.events import Event
from connectors.mqtt import broker_link, gap_replay, sender
from connectors.mqtt.broker import BRIEF_PAUSE, Broker, Message
from connectors.mqtt.gap_replay import GapRequest
from connectors.mqtt.outbox import Outbox
from connectors.mqtt.outbox_log import Entry
from connectors.mqtt.sender import Sender
from operators.errors import EndpointError
from tests.connectors.mqtt.made import EVENT
from tests.connectors.mqtt.made import opened as opened_outbox
from tests.faults.simulated_broker import SimulatedBroker, SimulatedLink
from tests.waiting import until

pytestmark = pytest.mark.virtual

URL = Broker.parse("mqtt://localhost")
RIG = "slip/v1/lab/rig"
WILL = Message(f"{RIG}/status", b"offline")
ONLINE = Message(f"{RIG}/status", b"online")


class Peer(SimulatedBroker):
    """Broker of one rig."""

    @property
    def got(self) -> list[tuple[str, str]]:
        """Received messages: topic below the rig's, and payload; of events their number."""
        return [(each.topic.removeprefix(f"{RIG}/"), said(each)) for each in self.published]

    def events(self) -> list[str]:
        return [what for topic, what in self.got if topic.endswith("/event")]


def said(message: Message) -> str:
    if message.topic.endswith("/event"):
        return str(Event.decode(message.payload).seq)
    return message.payload.decode()


def follow(sent: Iterable[Entry]) -> Iterator[Message]:
    """The head, as Mqtt has it retained."""
    for entry in sent:
        yield Message(f"{RIG}/head", str(entry.seq).encode())


@asynccontextmanager
async def opened(tmp_path: Path) -> AsyncGenerator[tuple[Sender, Outbox]]:
    health = count(1)
    async with opened_outbox(Outbox(tmp_path / "outbox")) as outbox:
        sending = Sender(
            URL, RIG, outbox, follow, lambda: Message(f"{RIG}/health", str(next(health)).encode())
        )
        try:
            yield sending, outbox
        finally:
            await sending.close(WILL)


@pytest.fixture
def peer(monkeypatch: pytest.MonkeyPatch) -> Peer:
    broker = Peer(Random(0))  # noqa: S311 - draws latencies
    monkeypatch.setattr(broker_link, "connect", broker.connect)
    return broker


@pytest.mark.parametrize("refused", ["head", "1/event"])
async def test_events_wait_for_a_refused_event_but_not_for_a_refused_document(
    tmp_path: Path, peer: Peer, caplog: pytest.LogCaptureFixture, refused: str
) -> None:
    caplog.set_level(logging.INFO, "slipflow")
    async with opened(tmp_path) as (sending, outbox):
        await sending.start("me", WILL, ONLINE)
        connected = [sending.connected]
        peer.refused.add(refused)
        await outbox.append([replace(EVENT, finger=str(int(number == 20))) for number in range(40)])
        first = 40 if refused == "head" else 20
        await until(lambda: outbox.waiting == 40 - first and sending.refused == [f"{RIG}/{refused}"])
        connected.append(sending.connected)
        peer.refused.clear()
        await until(lambda: not outbox.waiting and not sending.refused and ("head", "40") in peer.got)
        assert {*peer.events()} == {str(number) for number in range(1, 41)}
        assert [*connected, sending.connected] == [True, False, True]
    assert [(record.levelname, record.getMessage()) for record in caplog.records] == [
        ("ERROR", f"mqtt://localhost:1883: refuses to publish {RIG}/{refused}: Not authorized; retrying"),
        ("INFO", f"mqtt://localhost:1883: accepts {RIG}/{refused} again"),
    ]


async def test_each_new_reason_of_a_missing_broker_is_logged_once(
    tmp_path: Path, peer: Peer, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "slipflow")
    down, refused = EndpointError("broker", "is down"), EndpointError("broker", "refuses the password")
    failures: list[EndpointError] = [down, down, down, refused, refused]  # the first is that of `start`

    async def connect(*about: Any) -> SimulatedLink:
        if failures:
            raise failures.pop(0)
        return await peer.connect(*about)

    monkeypatch.setattr(broker_link, "connect", connect)
    async with opened(tmp_path) as (sending, outbox):
        await sending.start("me", WILL, ONLINE, connect_required=False)
        assert not sending.connected
        await until(lambda: sending.connected)
    rest = f", reconnecting; events are kept in {outbox.path}"
    assert [(record.levelname, record.getMessage()) for record in caplog.records] == [
        ("WARNING", f"broker: is down{rest}"),
        ("WARNING", f"broker: refuses the password{rest}"),
        ("INFO", "mqtt://localhost:1883: connected again, 0 events pending"),
    ]


@pytest.mark.parametrize("failures", [0, 1])
async def test_brief_connections_are_paced_and_blamed_on_another_run_unless_attempts_fail_in_between(
    tmp_path: Path,
    peer: Peer,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
    failures: int,
) -> None:
    caplog.set_level(logging.INFO, "slipflow")
    links, refusals = list[SimulatedLink](), list[EndpointError]()
    blame = f"connections of {RIG} end after moments; probably another run has this name, too: give each rig"

    async def connect(*about: Any) -> SimulatedLink:
        if refusals:
            raise refusals.pop()
        links.append(await peer.connect(*about))
        return links[-1]

    def logged() -> tuple[int, int]:
        lines = [(each.levelname, each.getMessage()) for each in caplog.records]
        blamed = sum(level == "ERROR" and blame in text for level, text in lines)
        return blamed, sum("connected again" in text for _, text in lines)

    monkeypatch.setattr(broker_link, "connect", connect)
    async with opened(tmp_path) as (sending, _):
        await sending.start("me", WILL, ONLINE)
        for _ in range(3):
            known = sum(logged())
            refusals += [EndpointError("broker", "is down")] * failures
            links[-1].abort()
            await until(lambda known=known: sum(logged()) > known)  # type: ignore[misc]
        assert failures or asyncio.get_running_loop().time() > 3 * BRIEF_PAUSE
    assert logged() == ((0, 3) if failures else (2, 1))


async def test_events_and_replies_get_a_share_of_each_turn(
    tmp_path: Path, peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gap_replay, "PAUSE", 0.0)
    async with opened(tmp_path) as (sending, outbox):
        await sending.start("me", WILL, ONLINE)
        await outbox.append([EVENT] * 20)
        await until(lambda: not outbox.waiting)
        other, begun = await peer.connect(URL, "other"), len(peer.published)
        for name in "abc":
            request = GapRequest(outbox.epoch, 1, 20, f"{RIG}/replay/{name}")
            other.publish(Message(f"{RIG}/replay/request", request.encode(), retain=False))
        await outbox.append([EVENT] * 400)
        await until(lambda: ("0/event", "420") in peer.got)
    topics = [topic for topic, _ in peer.got[begun:] if topic not in ("head", "replay/request")]
    for name in "abc":
        assert topics.count(f"replay/{name}") == 20 + 1
    ends = [len(topics) - topics[::-1].index(f"replay/{name}") for name in "abc"]
    for end, following in pairwise(ends):
        assert topics[end : following - 21] == ["0/event"] * sender.WINDOW


async def test_closing_sends_pending_messages_within_its_timeout(tmp_path: Path, peer: Peer) -> None:
    async with opened(tmp_path) as (sending, outbox):
        await sending.start("me", WILL, ONLINE)
        await outbox.append([EVENT] * 50)
    assert len(peer.events()) == 50
    async with opened(tmp_path) as (sending, outbox):
        await sending.start("me", WILL, ONLINE)
        peer.delay = 1e6  # s
        await outbox.append([EVENT])
        begun = asyncio.get_running_loop().time()
        await sending.close(WILL)
        assert asyncio.get_running_loop().time() - begun < 2 * sender.CLOSE_TIMEOUT + 1.0
        assert outbox.waiting == 1
