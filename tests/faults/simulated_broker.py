"""Simulated MQTT 5 broker and network in virtual time, behind the interface of `broker_link.Link`."""

import asyncio
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import inf, nextafter
from random import Random

from connectors.mqtt.broker import Broker, Message
from operators.errors import EndpointError
from tests.faults.simulated_process import current

TIMEOUT = 3.0  # s, as in `broker_link`
SESSION_EXPIRY = 10.0  # s


@dataclass
class _Session:
    """State of one client that the broker keeps between connections."""

    filters: set[str] = field(default_factory=set[str])
    unacknowledged: deque[Message] = field(default_factory=deque[Message])  # QoS 1, in order of delivery
    link: "SimulatedLink | None" = None
    disconnected: float = 0.0  # loop time (s) of the last disconnection


class SimulatedBroker:
    """Broker that keeps sessions and retained messages, and that faults can stop, slow down or cut off.

    It delivers at least once and keeps the order of messages of one topic, as MQTT 5 section 4.6 demands,
    and no other order.
    """

    def __init__(self, random: Random) -> None:
        self._random = random
        self.up = True
        self.delay = 1e-3  # s, mean latency of the network
        self.refused: set[str] = set()  # last level or levels of topics that may not be published
        self._sessions: dict[str, _Session] = {}
        self._retained: dict[str, Message] = {}
        self.published: list[Message] = []

    async def connect(
        self,
        broker: Broker,
        identifier: str,
        will: Message | None = None,
        changed: asyncio.Event | None = None,
    ) -> "SimulatedLink":
        process = current()
        await asyncio.sleep(self.latency())
        current()
        if not self.up:
            raise EndpointError(str(broker), "cannot connect: Connection refused")
        loop = asyncio.get_running_loop()
        session = self._sessions.get(identifier)
        if session and session.link:  # MQTT 5 section 3.1.4: the older connection is closed
            session.link.cut("session taken over")
        if session is None or session.disconnected + SESSION_EXPIRY < loop.time():
            session = self._sessions[identifier] = _Session()
        session.link = link = SimulatedLink(self, session, str(broker), changed or asyncio.Event())
        if process:
            process.on_kill.append(lambda: link.cut("process killed"))
        for message in session.unacknowledged:
            link.deliver(message)
        return link

    def stop(self, *, forget: bool) -> None:
        """Stop the broker; with `forget` it loses sessions and retained messages."""
        self.up = False
        self.cut_all("broker stopped")
        if forget:
            self._sessions.clear()
            self._retained.clear()

    def start(self) -> None:
        self.up = True

    def cut_all(self, reason: str = "connection reset") -> None:
        for session in list(self._sessions.values()):
            if session.link:
                session.link.cut(reason)

    def receive(self, message: Message) -> str:
        """Route a published message; return the reason for a refusal, empty if accepted."""
        if any(message.topic.endswith(f"/{each}") for each in self.refused):
            return f"refuses to publish {message.topic}: Not authorized"
        self.published.append(message)
        if message.retain:
            self._retained[message.topic] = message
        for session in self._sessions.values():
            if any(matches(each, message.topic) for each in session.filters):
                self._route(session, message)
        return ""

    def subscribe(self, session: _Session, topics: Sequence[str]) -> None:
        """Add topic filters and deliver retained messages."""
        session.filters |= set(topics)
        for message in self._retained.values():
            if message.payload and any(matches(each, message.topic) for each in topics):
                self._route(session, message)

    def _route(self, session: _Session, message: Message) -> None:
        session.unacknowledged.append(message)
        if session.link:
            session.link.deliver(message)

    def latency(self) -> float:
        return self._random.expovariate(1 / self.delay)


class SimulatedLink:
    """One connection of a client, as `broker_link.Link`."""

    def __init__(self, broker: SimulatedBroker, session: _Session, url: str, changed: asyncio.Event) -> None:
        self._broker, self._session, self._url, self._changed = broker, session, url, changed
        self._loop = asyncio.get_running_loop()
        self._inbox = deque[Message]()
        self._lost = ""  # reason; empty while connected
        self._answers = set[asyncio.Future[str | None]]()
        self._next = 0.0  # loop time (s): packets of one client arrive in order
        self._next_of: dict[str, float] = {}  # the same for deliveries, by topic
        self.dropped = 0

    @property
    def alive(self) -> bool:
        return not self._lost

    async def send_all(self, messages: Sequence[Message]) -> list[str]:
        answers = [self.publish(message) for message in messages]
        try:
            async with asyncio.timeout(TIMEOUT):
                found = await asyncio.gather(*answers)
        except TimeoutError:
            self.cut("timed out")
            raise EndpointError(self._url, "connection lost (no response)") from None
        refusals = [reason for reason in found if reason is not None]
        if len(refusals) < len(messages):
            raise EndpointError(self._url, f"connection lost ({self._lost})")
        return refusals

    async def listen(self, *topics: str) -> None:
        current()
        await asyncio.sleep(self._broker.latency())
        current()
        if self._lost:
            raise EndpointError(self._url, f"connection lost ({self._lost})")
        self._broker.subscribe(self._session, topics)

    async def receive(self) -> tuple[str, bytes]:
        while (message := self.next_received()) is None:
            self._changed.clear()
            await self._changed.wait()
        return message

    def next_received(self) -> tuple[str, bytes] | None:
        current()
        if self._inbox:
            message = self._inbox.popleft()
            return message.topic, message.payload
        if self._lost:
            raise EndpointError(self._url, f"connection lost ({self._lost})")
        return None

    async def disconnect(self) -> None:
        self.cut("disconnected")

    def abort(self) -> None:
        self.cut("aborted")

    def deliver(self, message: Message) -> None:
        """Deliver a message after the latency of the network, in order within its topic."""
        when = max(self._loop.time() + self._broker.latency(), self._next_of.get(message.topic, 0.0))
        self._next_of[message.topic] = nextafter(when, inf)  # timers of equal times run in any order
        self._loop.call_at(when, self._arrive, message)

    def _arrive(self, message: Message) -> None:
        if self._lost:
            return  # redelivered in the next connection
        self._inbox.append(message)
        self._changed.set()
        self._loop.call_later(self._broker.latency(), self._acknowledge, message)

    def _acknowledge(self, message: Message) -> None:
        if not self._lost:
            with suppress(ValueError):
                self._session.unacknowledged.remove(message)

    def publish(self, message: Message) -> "asyncio.Future[str | None]":
        current()
        answer: asyncio.Future[str | None] = self._loop.create_future()
        if self._lost:
            answer.set_result(None)
            return answer
        self._answers.add(answer)
        answer.add_done_callback(self._answers.discard)
        when = max(self._loop.time() + self._broker.latency(), self._next)
        self._next = nextafter(when, inf)

        def arrive() -> None:
            if self._lost:
                return
            refusal = self._broker.receive(message)
            self._loop.call_later(self._broker.latency(), confirm, refusal)

        def confirm(refusal: str) -> None:
            if not self._lost and not answer.done():
                answer.set_result(refusal)

        self._loop.call_at(when, arrive)
        return answer

    def cut(self, reason: str) -> None:
        if self._lost:
            return
        self._lost = reason
        if self._session.link is self:
            self._session.link, self._session.disconnected = None, self._loop.time()
        for answer in list(self._answers):
            if not answer.done():
                answer.set_result(None)
        self._changed.set()


def matches(pattern: str, topic: str) -> bool:
    """Return True if a topic matches a filter with ``+`` levels.

    >>> matches("slip/+/head", "slip/lab/head"), matches("slip/+", "slip/lab/head")
    (True, False)
    """
    left, right = pattern.split("/"), topic.split("/")
    return len(left) == len(right) and all(a in ("+", b) for a, b in zip(left, right, strict=True))
