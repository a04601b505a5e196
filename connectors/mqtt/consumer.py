"""Consumer of slip events over MQTT that delivers each event once and fetches the ones it missed."""

import asyncio
import logging
import os
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack
from pathlib import Path
from secrets import token_hex
from typing import TYPE_CHECKING, Literal, Self

from connectors.documents import Document, decode
from connectors.events import Event
from connectors.mqtt.broker import Broker, Message, Pauses
from connectors.mqtt.gap_replay import GapAnswer, GapRequest
from connectors.mqtt.position import Position, RigId, load, lock_position, read_heads
from connectors.mqtt.rig_names import NAME_MAX, is_topic_level, rig_topic
from operators.checks import check_choice
from operators.errors import EndpointError, InputError, SlipflowError, os_error_reason
from storage.background_task import BackgroundTask
from storage.files import put

if TYPE_CHECKING:
    from connectors.mqtt.broker_link import Link

log = logging.getLogger("slipflow")

CHECK_EVERY = 3.0  # s, between checks of all rigs for missed events
REQUESTS_MAX = 100  # requests per check
MALFORMED_MAX = 20  # malformed messages that are reported per connection


class _Reply(Document, frozen=True):
    specversion: str | None = None  # of an event; a closing answer has none


class Consumer(AsyncIterator[Event]):
    """Slip events from a broker, each once.

    A missed event is fetched from the rig and arrives late, after newer ones. Events that the rig no longer
    keeps are reported as lost. The consumer reconnects after a lost connection.

    The position is saved when the loop requests the next event, so after a crash the event in progress is
    delivered again: deduplicate on `Event.identifier`. One consumer at a time can use a file.

        async with Consumer("mqtt://localhost", site="lab", position_file="events.position") as events:
            async for event in events:
                print(event.time, event.finger, event.state)

    Args:
        url: Address of the broker, see `connectors.mqtt.broker.Broker`.
        site: Site; ``+``: all.
        rig: Rig; ``+``: all.
        position_file: File of the position at which the consumer resumes; None: it does not resume.
        since: Events of a rig without a position: from its next one (``now``) or its oldest one (``start``).
        report: Takes messages about lost events, malformed messages and lost connections.

    Raises:
        ParameterError: if `url`, `site`, `rig` or `since` is invalid.
    """

    def __init__(
        self,
        url: str,
        site: str = "+",
        rig: str = "+",
        *,
        position_file: str | Path | None = None,
        since: Literal["now", "start"] = "now",
        report: Callable[[str], object] = log.warning,
    ) -> None:
        self._broker = Broker.parse(url, "Consumer")
        self._topic = rig_topic("Consumer", site, rig, wildcard="+")
        check_choice("Consumer", "since", since, ("now", "start"))
        self._everything, self._report = since == "start", report
        self._position_file = Path(position_file) if position_file else None
        self._position = Position(everything=self._everything)
        self._reply_name = f"consumer-{token_hex(6)}"  # last level of the topic for replies
        self._link: Link | None = None
        self._pauses = Pauses()
        self._malformed, self._refused = 0, False  # messages and a request of this connection
        self._check_due = 0.0  # loop time (s) of the next check of all rigs for gaps
        self._event: Event | None = None  # the event in progress, which the position does not have yet
        self._saving: BackgroundTask | None = None
        self._changed = False  # the position changed since it was saved
        self._unsaved = ""  # why it could not be saved

    async def __aenter__(self) -> Self:
        """Load the position and connect.

        Raises:
            EndpointError: if the broker is unreachable or refuses the connection, or the position file cannot
                be read or written or is in use.
            InputError: if the file is not a position file, or a file with credentials cannot be read.
        """
        async with AsyncExitStack() as ends:
            if path := self._position_file:
                ends.callback(os.close, lock_position(path))
                self._position = await asyncio.to_thread(load, path, everything=self._everything)
            self._link = await self._connect()
            ends.push_async_callback(self._disconnect)
            self._ends = ends.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        """Disconnect; the next run delivers an event in progress again."""
        try:
            self._save_position()
            if self._saving:
                await self._saving.end(None)
        finally:
            await self._ends.aclose()
        if self._saving:
            self._saving.check()

    async def __anext__(self) -> Event:
        """Return the next event; wait as long as necessary."""
        self._finish_event()
        while True:
            link = self._link or await self._reconnect()
            if asyncio.get_running_loop().time() >= self._check_due:
                self._check_due = asyncio.get_running_loop().time() + CHECK_EVERY
                self._save_position()
                self._check(link)
            try:
                async with asyncio.timeout_at(self._check_due):
                    topic, payload = await link.receive()
            except TimeoutError:
                continue
            except EndpointError as error:
                self._report(f"{error}, reconnecting")
                await self._disconnect()
                continue
            if link.dropped:
                self._report(f"{self._broker}: the consumer is behind: {link.dropped} messages dropped")
                link.dropped = 0
            try:
                rig, self._event = self._process(topic, payload)
            except InputError as error:
                self._malformed += 1
                rest = " (further ones are not reported)" if self._malformed == MALFORMED_MAX else ""
                if self._malformed <= MALFORMED_MAX:
                    self._report(f"ignoring malformed message: {error}{rest}")
                continue
            if self._event:
                return self._event
            self._request_missed(link, rig)

    def _check(self, link: "Link") -> None:
        """Request missed events of up to 100 rigs; the next check asks others, as these may still answer."""
        requests = 0
        for rig in reversed(self._position.rigs):
            requests += self._request_missed(link, rig)
            if requests == REQUESTS_MAX:
                break

    def _process(self, topic: str, payload: bytes) -> tuple[RigId, Event | None]:
        """Process a message; return its rig, and its event if the event is new."""
        _, _, site, name, *rest = topic.split("/")
        rig = site, name
        if not (topic.isprintable() and is_topic_level(site) and is_topic_level(name)):
            reason = f"site and rig of a topic must be printable text of 1 to {NAME_MAX} characters"
            raise InputError(f"{topic!a:.200}", reason)
        reply = ["replay", self._reply_name]
        if rest == ["head"]:
            self._change(self._position.announce(rig, read_heads(payload, topic)))
        elif rest == reply and decode(payload, _Reply, topic).specversion is None:
            now = asyncio.get_running_loop().time()
            self._change(self._position.settle(rig, decode(payload, GapAnswer, topic), now))
        else:
            event = Event.decode(payload, topic)
            if (event.site, event.rig) != rig or rest not in ([event.finger, "event"], reply):
                raise InputError(topic, f"has an event of {event.site}/{event.rig}/{event.finger}")
            return rig, None if self._position.has(event) else event
        return rig, None

    def _finish_event(self) -> None:
        """Mark the latest event as processed, and start saving the position."""
        if event := self._event:
            self._event = None
            self._change(self._position.take(event))
            if self._link:
                self._request_missed(self._link, (event.site, event.rig))
        self._save_position()

    def _change(self, lost: list[str]) -> None:
        """Note that the position has changed, and report lost events."""
        self._changed = True
        for text in lost:
            self._report(text)

    def _request_missed(self, link: "Link", rig: RigId) -> bool:
        """Request missed events of a rig if there are any, unless it may still answer the latest request."""
        gap = self._position.request(rig, asyncio.get_running_loop().time())
        if gap is None:
            return False
        topic = rig_topic("Consumer", *rig)
        payload = GapRequest(*gap, f"{topic}/replay/{self._reply_name}").encode()
        answer = link.publish(Message(f"{topic}/replay/request", payload, retain=False))
        answer.add_done_callback(self._report_refusal)
        return True

    def _report_refusal(self, answer: "asyncio.Future[str | None]") -> None:
        """Report the first request of a connection that the broker refuses."""
        if (reason := answer.result()) and not self._refused:
            self._refused = True
            self._report(f"{self._broker}: {reason}; missed events cannot be fetched")

    async def _reconnect(self) -> "Link":
        failure = ""
        while self._link is None:
            await self._pauses.wait()
            try:
                self._link = await self._connect()
            except SlipflowError as error:
                if failure != str(error):
                    self._report(f"{error}, reconnecting")
                failure = str(error)
            else:
                self._report(f"{self._broker}: connected again")
        return self._link

    async def _connect(self) -> "Link":
        from connectors.mqtt.broker_link import connect

        link = await connect(self._broker, f"slipflow-{self._reply_name}")
        try:  # heads last, so that an event in flight does not look like a gap
            names = "+/event", f"replay/{self._reply_name}", "head"
            await link.listen(*(f"{self._topic}/{name}" for name in names))
        except BaseException:
            await link.disconnect()
            raise
        self._pauses.connected()
        self._malformed, self._refused, self._check_due = 0, False, 0.0
        self._position.reconnected()
        return link

    async def _disconnect(self) -> None:
        if self._link:
            await self._link.disconnect()
        self._link = None

    def _save_position(self) -> None:
        """Start saving the position, if it has changed and is not being saved."""
        if self._saving:
            self._saving.check()
        if self._position_file and self._changed and (self._saving is None or self._saving.done):
            path, purpose = self._position_file, "the saving of the position"
            self._saving = BackgroundTask(str(path), purpose, self._save(path), endless=False)

    async def _save(self, path: Path) -> None:
        while self._changed:
            self._changed = False
            try:
                await asyncio.to_thread(put, path, self._position.encode())
            except OSError as error:
                before, self._unsaved, self._changed = self._unsaved, os_error_reason(error), True
                if self._unsaved != before:
                    self._report(f"{path}: cannot be written: {self._unsaved}")
                return  # the next check tries again
            self._unsaved = ""
