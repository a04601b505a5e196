"""Sender of a rig: task that publishes its outbox and its retained documents."""

import asyncio
import logging
from collections.abc import Callable, Iterable
from contextlib import suppress
from itertools import takewhile
from typing import TYPE_CHECKING

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

WINDOW = 16  # events in flight
CLOSE_TIMEOUT = 3.0  # s, to send what is pending on close
HEALTH_EVERY = 5.0  # s, between health reports, and between attempts on refused topics

_SHARED_NAME = (
    "%s: connections of %s end after moments; probably another run has this name, too: give each rig its own"
)


class Sender:
    """A task that publishes events, the retained documents they change, and answers to gap requests.

    After each connection it repeats the retained documents, which the broker may have lost, and restarts at
    the oldest unacknowledged event. A message that the broker refuses is sent again with the next health
    report; the events after a refused one wait for it. Each turn sends a window of events and a slice of an
    answer, so that neither delays the other for long.
    """

    def __init__(
        self,
        broker: Broker,
        topic: str,
        outbox: Outbox,
        documents: Callable[[Iterable[Entry]], Iterable[Message]],
        health: Callable[[], Message],
    ) -> None:
        """Prepare to publish below `topic`, with the `documents` after a send, and `health` every 5 s."""
        self._broker, self._topic, self._outbox = broker, topic, outbox
        self._documents, self._health = documents, health
        self._replies = GapReplies(outbox, topic)
        self._retained: dict[str, Message] = {}  # by topic
        self._changed: dict[str, Message] = {}  # retained documents to publish, by topic
        self._refused = set[str]()  # topics, skipped until the next health report
        self._health_due = 0.0  # loop time, s
        self._link: Link | None = None
        self._wake, self._closing = asyncio.Event(), False
        self._sending: BackgroundTask | None = None
        outbox.on_pending = self._wake.set

    @property
    def connected(self) -> bool:
        """True while the broker is connected and refuses no topic."""
        return bool(self._link and self._link.alive and not self._refused)

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
        """
        self._identifier, self._will = identifier, will
        self._retained = {message.topic: message for message in retained}
        try:
            link = await self._connect()
            if reason := next(filter(None, await link.send_all(retained)), ""):
                raise EndpointError(str(self._broker), reason)  # noqa: TRY301 - as one that `_connect` raises
            self._changed.clear()
        except BaseException as error:
            await self._disconnect()
            if connect_required or not isinstance(error, EndpointError):
                raise
        self._health_due = asyncio.get_running_loop().time() + HEALTH_EVERY
        self._sending = BackgroundTask(str(self._broker), "the sending of events", self._keep_sending())

    async def close(self, *last: Message) -> None:
        """Send pending messages within 3 s, then the `last`, disconnect; raise a failure of the task."""
        self._closing = True
        self._wake.set()
        if self._sending:
            await self._sending.end(CLOSE_TIMEOUT if self._link else 0.0)
        if self._link and self._link.alive:
            with suppress(EndpointError):
                await self._link.send_all(last)
        await self._disconnect()
        if self._sending:
            self._sending.check()

    async def _keep_sending(self) -> None:
        failure, pauses = "", Pauses()
        while True:
            try:
                link = self._link or await self._connect()
                pauses.connected()
                if pauses.brief > 1:
                    log.error(_SHARED_NAME, self._broker, self._topic)
                elif failure:
                    log.info("%s: connected again, %d events pending", self._broker, self._outbox.waiting)
                failure = ""
                while await self._send_pending(link) or not self._closing:
                    pass
            except Exception as error:  # noqa: BLE001 - sending continues after any error
                await self._disconnect()
                if str(error) != failure and pauses.brief <= 1:
                    log.warning("%s, reconnecting; events are kept in %s", error, self._outbox.path)
                failure = str(error)
            if self._closing:
                return
            await pauses.wait()

    async def _connect(self) -> "Link":
        from connectors.mqtt.broker_link import connect

        self._link = link = await connect(self._broker, self._identifier, self._will, self._wake)
        self._replies.clear()
        self._changed, self._refused = dict(self._retained), set()
        requests = f"{self._topic}/replay/request"
        try:
            await link.listen(requests)
        except EndpointError as error:
            if not link.alive:
                raise
            self._refuse(requests, f"{error}; consumers cannot request missed events")
        return link

    async def _send_pending(self, link: "Link") -> bool:
        """Send one window of everything pending; if there is nothing, wait and return False."""
        self._wake.clear()
        while received := link.next_received():
            self._replies.request(received[1])
        now, skipped = asyncio.get_running_loop().time(), self._refused
        if now >= self._health_due:
            self._health_due, skipped = now + HEALTH_EVERY, set()
            self._retain(self._health())
        events_refused = any(topic.endswith("/event") for topic in skipped)
        entries = [] if events_refused else await self._outbox.next(WINDOW)
        documents = [each for each in self._changed.values() if each.topic not in skipped]
        replies = await self._replies.next(now)
        outgoing = [*documents, *map(self._event, entries), *replies]
        refusals = await link.send_all(outgoing)
        for message, refusal in zip(outgoing, refusals[: len(outgoing) - len(replies)], strict=False):
            if refusal:
                self._refuse(message.topic, f"{self._broker}: {refusal}; retrying")
            else:
                self._accept(message)
        answered = zip(entries, refusals[len(documents) :], strict=False)
        if sent := [entry for entry, refusal in takewhile(lambda each: not each[1], answered)]:
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

    def _event(self, entry: Entry) -> Message:
        topic = f"{self._topic}/{entry.finger}/event"
        return Message(topic, entry.payload, retain=False, content_type=CONTENT_TYPE)

    def _accept(self, message: Message) -> None:
        if self._changed.get(message.topic) is message:
            del self._changed[message.topic]
        if message.topic in self._refused:
            self._refused.remove(message.topic)
            log.info("%s: accepts %s again", self._broker, message.topic)

    def _refuse(self, topic: str, text: str) -> None:
        if topic not in self._refused:
            log.error("%s", text)
        self._refused.add(topic)

    async def _disconnect(self) -> None:
        if self._link:
            await self._link.disconnect()
        self._link = None
