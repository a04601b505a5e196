"""Sender of a rig: task that publishes its outbox and its retained documents."""

import asyncio
import logging
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import TYPE_CHECKING, TypeAlias

from connectors.events import CONTENT_TYPE
from connectors.mqtt.broker import Broker, Message, Pauses
from connectors.mqtt.gap_replay import GapReplies
from connectors.mqtt.outbox import Outbox
from connectors.mqtt.outbox_log import Entry
from operators.errors import EndpointError
from storage.background_task import BackgroundTask

if TYPE_CHECKING:
    from connectors.mqtt.broker_link import Link

log = logging.getLogger("slipflow")

WINDOW = 16  # events, and as many documents, in flight
CLOSE_TIMEOUT = 3.0  # s, to send what is pending on close
HEALTH_EVERY = 5.0  # s, between health reports, and between attempts on refused topics

_SHARED_NAME = (
    "%s: connections of %s end after moments; probably another run has this name, too: give each rig its own"
)
Outgoing: TypeAlias = tuple[Message, Entry | None]  # a message, and its event if it is one of the outbox


class Sender:
    """A task that publishes events, the retained documents they change, and answers to gap requests.

    After each connection it repeats the retained documents, which the broker may have lost, and restarts at
    the oldest unacknowledged event. A topic that the broker refuses does not delay other topics. Each turn
    sends a window of events and a slice of an answer, so that neither delays the other for long.
    """

    def __init__(
        self,
        broker: Broker,
        topic: str,
        outbox: Outbox,
        documents: Callable[[Iterable[Entry]], Iterable[Message]],
        health: Callable[[], Message],
    ) -> None:
        """Prepare to publish below `topic`.

        `documents` returns the retained documents after a send; `health` is published every 5 s.
        """
        self._broker, self._topic, self._outbox = broker, topic, outbox
        self._documents, self._health = documents, health
        self._replies = GapReplies(outbox, topic)
        self._retained: dict[str, Message] = {}  # by topic
        self._changed: dict[str, Message] = {}  # retained documents to publish, by topic
        self._refused = set[str]()  # topics that are skipped until the next attempt
        self._logged = set[str]()  # topics whose refusal was logged
        self._health_due = 0.0  # loop time, s
        self._link: Link | None = None
        self._wake, self._closing = asyncio.Event(), False
        self._sending: BackgroundTask | None = None
        outbox.on_pending = self._wake.set

    @property
    def refused(self) -> list[str]:
        """Topics that the broker refuses."""
        return sorted(self._refused)

    async def start(
        self, identifier: str, will: Message, *retained: Message, connect_required: bool = True
    ) -> None:
        """Connect, publish the retained documents, and start sending in the background.

        Raises:
            EndpointError: if the broker is unreachable or refuses, unless `connect_required` is False.
            InputError: if a file with credentials or certificate authorities cannot be read.
        """
        self._identifier, self._will = identifier, will
        for message in retained:
            self._retained[message.topic] = message
        if connect_required:
            try:
                await self._send_retained(await self._connect())
            except BaseException:
                await self._disconnect()
                raise
        else:  # raise the errors that a retry cannot fix
            self._broker.login()
            if self._broker.scheme == "mqtts":
                self._broker.tls()
        self._health_due = asyncio.get_running_loop().time() + HEALTH_EVERY
        self._sending = BackgroundTask(str(self._broker), "the sending of events", self._keep_sending())

    async def close(self, offline: Message) -> None:
        """Send pending messages within 3 s, publish `offline`, and disconnect.

        Raises:
            EndpointError: if the sending has failed, other than by a failure of the broker.
        """
        self._closing = True
        self._wake.set()
        if self._sending:
            await self._sending.end(CLOSE_TIMEOUT if self._link else 0.0)
        if self._link and self._link.alive:
            with suppress(EndpointError):
                await self._link.send_all([offline])
        await self._disconnect()
        if self._sending:
            self._sending.check()

    async def _keep_sending(self) -> None:
        failed, pauses = False, Pauses()
        while True:
            try:
                link = self._link or await self._connect()
                pauses.connected()
                if pauses.brief > 1:
                    log.error(_SHARED_NAME, self._broker, self._topic)
                elif failed:
                    log.warning("%s: connected again, %d events pending", self._broker, self._outbox.waiting)
                failed = False
                while await self._send_pending(link) or not self._closing:
                    pass
            except Exception as error:  # noqa: BLE001 - sending continues after any error
                await self._disconnect()
                if not failed and pauses.brief <= 1:
                    log.warning("%s, reconnecting; events are kept in %s", error, self._outbox.path)
                failed = True
            if self._closing:
                return
            await pauses.wait()

    async def _connect(self) -> "Link":
        from connectors.mqtt.broker_link import connect

        self._link = link = await connect(self._broker, self._identifier, self._will, self._wake)
        self._refused.clear()
        self._replies.clear()
        self._changed = dict(self._retained)
        try:
            await link.listen(f"{self._topic}/replay/request")
        except EndpointError as error:
            if not link.alive:
                raise
            self._log_once("replay/request", f"{error}; consumers cannot request missed events")
        return link

    async def _send_retained(self, link: "Link") -> None:
        """Publish the retained documents.

        Raises:
            EndpointError: if the connection is lost, or one is refused.
        """
        for refusal in await link.send_all(list(self._retained.values())):
            if refusal:
                raise EndpointError(str(self._broker), refusal)
        self._changed.clear()

    async def _send_pending(self, link: "Link") -> bool:
        """Send one window of everything pending; if there is nothing, wait and return False.

        Raises:
            EndpointError: if the connection is lost.
        """
        self._wake.clear()
        while received := link.next_received():
            self._replies.request(received[1])
        now = asyncio.get_running_loop().time()
        if now >= self._health_due:
            self._health_due = now + HEALTH_EVERY
            self._retain(self._health())
            self._refused.clear()
        entries = await self._outbox.next(
            WINDOW, lambda finger: self._event_topic(finger) not in self._refused
        )
        replies = await self._replies.next(now)
        outgoing: list[Outgoing] = [
            *((message, None) for message in self._changed.values() if message.topic not in self._refused),
            *((self._event(entry), entry) for entry in entries),
            *((message, None) for message in replies),
        ]
        sent = list[Entry]()
        refusals = await link.send_all([message for message, _ in outgoing])
        for (message, entry), refusal in zip(outgoing, refusals, strict=True):
            if not refusal:
                self._accept(message)
                sent += [entry] if entry else []
            elif message not in replies:  # the client repeats its request
                self._refused.add(message.topic)
                self._log_once(message.topic, f"{self._broker}: {refusal}; retrying")
        if sent:
            self._outbox.acknowledge(sent)
            for message in self._documents(sent):
                self._retain(message)
        if not outgoing and not self._closing:
            with suppress(TimeoutError):
                async with asyncio.timeout_at(min(self._health_due, self._replies.due)):
                    await self._wake.wait()
        return bool(outgoing)

    def _retain(self, message: Message) -> None:
        """Publish a retained document now and after each connection, until a newer one replaces it."""
        self._retained[message.topic] = self._changed[message.topic] = message

    def _event_topic(self, finger: str) -> str:
        return f"{self._topic}/{finger}/event"

    def _event(self, entry: Entry) -> Message:
        topic = self._event_topic(entry.finger)
        return Message(topic, entry.payload, retain=False, content_type=CONTENT_TYPE)

    def _accept(self, message: Message) -> None:
        if self._changed.get(message.topic) is message:
            del self._changed[message.topic]
        if message.topic in self._logged:
            self._logged.discard(message.topic)
            log.warning("%s: accepts %s again", self._broker, message.topic)

    def _log_once(self, topic: str, text: str) -> None:
        if topic not in self._logged:
            self._logged.add(topic)
            log.warning("%s", text)

    async def _disconnect(self) -> None:
        if self._link:
            await self._link.disconnect()
        self._link = None
