import asyncio
from collections.abc import AsyncGenerator, Iterable, Iterator, Sequence
from contextlib import asynccontextmanager
from itertools import count
from pathlib import Path

import pytest

from connectors.events import Event
from connectors.mqtt import broker_link as module
from connectors.mqtt import gap_replay, sender
from connectors.mqtt.broker import Broker, Message, Pauses
from connectors.mqtt.gap_replay import GapRequest
from connectors.mqtt.outbox import Outbox
from connectors.mqtt.outbox_log import Entry
from connectors.mqtt.sender import Sender
from operators.errors import EndpointError
from operators.ports import BackOff
from tests.inside import inside
from tests.waiting import until

RIG = "slip/v1/lab/rig"
WILL = Message(f"{RIG}/status", b"offline")
ONLINE = Message(f"{RIG}/status", b"online")
DRAFT = Event(
    site="lab", rig="rig", finger="0", epoch="", seq=0, state="onset", time=1, probability=0.9, latency=1.0
)


class Peer:
    """Stands for the broker, over all its connections."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.connections: list[Connection] = []
        self.refused = set[str]()  # topics
        self.holds = asyncio.Event()  # cleared: it does not answer
        self.holds.set()
        self.waiting = 0  # for its answer
        self.away = False
        monkeypatch.setattr(module, "connect", self._connect)

    @property
    def got(self) -> list[tuple[str, str]]:
        """Received messages: topic below the rig's, and payload; of events their number."""
        return [
            (message.topic.removeprefix(f"{RIG}/"), said(message))
            for each in self.connections
            for message in each.got
        ]

    def events(self) -> list[str]:
        return [what for topic, what in self.got if topic.endswith("/event")]

    async def _connect(
        self, broker: Broker, identifier: str, will: Message, changed: asyncio.Event
    ) -> "Connection":
        if self.away:
            raise EndpointError(str(broker), "cannot connect: no broker")
        self.connections.append(Connection(self, changed))
        return self.connections[-1]


class Connection:
    """Stands for a Link."""

    def __init__(self, peer: Peer, changed: asyncio.Event) -> None:
        self._peer, self._changed = peer, changed
        self.alive, self.got, self.disconnected = True, list[Message](), False
        self._requests = list[bytes]()
        self.batches = list[list[str]]()  # topics of the messages sent together

    def lose(self) -> None:
        self.alive = False
        self._changed.set()

    def request(self, payload: bytes) -> None:
        self._requests.append(payload)
        self._changed.set()

    async def listen(self, *topics: str) -> None:
        if set(topics) & self._peer.refused:
            raise EndpointError("broker", f"refuses to subscribe to {topics[0]}")

    def next_received(self) -> tuple[str, bytes] | None:
        if not self.alive:
            raise EndpointError("broker", "connection lost")
        return (f"{RIG}/replay/request", self._requests.pop(0)) if self._requests else None

    async def send_all(self, messages: Sequence[Message]) -> list[str]:
        self._peer.waiting += 1
        await self._peer.holds.wait()
        self._peer.waiting -= 1
        if not self.alive:
            raise EndpointError("broker", "connection lost")
        self.batches.append([message.topic for message in messages])
        self.got += [message for message in messages if message.topic not in self._peer.refused]
        return ["refuses" if message.topic in self._peer.refused else "" for message in messages]

    async def disconnect(self) -> None:
        self.alive, self.disconnected = False, True


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
    outbox = Outbox(tmp_path / "outbox")
    await outbox.open()
    health = count(1)
    sending = Sender(
        Broker.parse("mqtt://localhost"),
        RIG,
        outbox,
        follow,
        lambda: Message(f"{RIG}/health", str(next(health)).encode()),
    )
    try:
        yield sending, outbox
    finally:
        await sending.close(WILL)
        await outbox.close()


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sender, "Pauses", lambda: Pauses(BackOff(0.01, 0.02)))
    monkeypatch.setattr(sender, "CLOSE_TIMEOUT", 0.2)


@pytest.fixture
def peer(monkeypatch: pytest.MonkeyPatch) -> Peer:
    return Peer(monkeypatch)


def draft(finger: str) -> Event:
    return Event(
        site="lab",
        rig="rig",
        finger=finger,
        epoch="",
        seq=0,
        state="onset",
        time=1,
        probability=0.9,
        latency=1.0,
    )


async def test_events_are_sent_once_in_order_and_documents_after_their_acknowledgement(
    tmp_path: Path, peer: Peer
) -> None:
    async with opened(tmp_path) as (sending, outbox):
        await sending.start("me", WILL, ONLINE)
        assert peer.got == [("status", "online")]
        peer.holds.clear()
        await outbox.append([DRAFT] * 3)
        await outbox.append([DRAFT])
        peer.holds.set()
        await until(lambda: not outbox.waiting and ("head", "4") in peer.got)
    for number in range(1, 5):
        if ("head", str(number)) in peer.got:
            assert peer.got.index(("head", str(number))) > peer.got.index(("0/event", str(number)))
    assert peer.events() == ["1", "2", "3", "4"]
    assert peer.got[-1] == ("status", "offline")


async def test_without_a_required_connection_a_sender_starts_and_sends_later(
    tmp_path: Path, peer: Peer, caplog: pytest.LogCaptureFixture
) -> None:
    peer.away = True
    async with opened(tmp_path) as (sending, outbox):
        with pytest.raises(EndpointError, match="no broker"):
            await sending.start("me", WILL, ONLINE)
        await sending.start("me", WILL, ONLINE, connect_required=False)
        await outbox.append([DRAFT] * 2)
        await until(lambda: bool(caplog.messages))
        assert outbox.waiting == 2
        peer.away = False
        await until(lambda: not outbox.waiting and ("head", "2") in peer.got)
    assert peer.got[0] == ("status", "online")
    assert peer.events() == ["1", "2"]
    away, back = caplog.messages
    assert "no broker, reconnecting; events are kept in" in away
    assert "connected again, 2 events pending" in back


@pytest.mark.parametrize("refused", ["head", "1/event"])
async def test_events_wait_for_a_refused_event_but_not_for_a_refused_document(
    tmp_path: Path,
    peer: Peer,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    refused: str,
) -> None:
    monkeypatch.setattr(sender, "HEALTH_EVERY", 0.1)
    async with opened(tmp_path) as (sending, outbox):
        await sending.start("me", WILL, ONLINE)
        peer.refused.add(f"{RIG}/{refused}")
        await outbox.append([draft(str(number // 20)) for number in range(40)])
        first = 40 if refused == "head" else 20
        await until(lambda: outbox.waiting == 40 - first and sending.refused == [f"{RIG}/{refused}"])
        peer.refused.clear()
        await until(lambda: not outbox.waiting and not sending.refused and ("head", "40") in peer.got)
        assert list(dict.fromkeys(peer.events())) == [str(number) for number in range(1, 41)]
    assert caplog.messages == [
        "mqtt://localhost:1883: refuses; retrying",
        f"mqtt://localhost:1883: accepts {RIG}/{refused} again",
    ]


async def test_events_and_replies_get_a_share_of_each_turn(
    tmp_path: Path, peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gap_replay, "PAUSE", 0.0)
    async with opened(tmp_path) as (sending, outbox):
        await sending.start("me", WILL, ONLINE)
        await outbox.append([DRAFT] * 20)
        await until(lambda: not outbox.waiting)
        peer.holds.clear()
        for name in "abc":
            peer.connections[0].request(GapRequest(outbox.epoch, 1, 20, f"{RIG}/replay/{name}").encode())
        await until(lambda: bool(peer.waiting))
        await outbox.append([DRAFT] * 400)
        begun = len(peer.connections[0].batches)
        peer.holds.set()
        await until(lambda: ("0/event", "400") in peer.got)
        turns = peer.connections[0].batches[begun:][:3]
    for turn, name in zip(turns, "abc", strict=True):
        assert turn.count(f"{RIG}/replay/{name}") == 20 + 1
    assert [turn.count(f"{RIG}/0/event") for turn in turns[1:]] == [sender.WINDOW] * 2


async def test_closing_sends_pending_messages_within_its_timeout(tmp_path: Path, peer: Peer) -> None:
    async with opened(tmp_path) as (sending, outbox):
        await sending.start("me", WILL, ONLINE)
        await outbox.append([DRAFT] * 50)
    assert len(peer.events()) == 50
    async with opened(tmp_path) as (sending, outbox):
        await sending.start("me", WILL, ONLINE)
        peer.holds.clear()
        await outbox.append([DRAFT])
        stuck = asyncio.create_task(sending.close(WILL))
        await asyncio.sleep(0)
        await until(lambda: inside(sending, "_sending").done)
        peer.holds.set()  # the farewell is bounded by the link
        await stuck
        assert outbox.waiting == 1
