"""Sender of a rig: task that publishes its outbox and its retained documents."""

import asyncio
import logging
from collections.abc import Callable, Iterable
from contextlib import suppress
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

_SHARED_NAME = (
    "%s: connections of %s end after moments; probably another run has this name, too: give each rig its own"
)


class Sender:
    """A task that publishes events, the retained documents they change, and answers to gap requests.

    After each connection it repeats the retained documents, which the broker may have lost, and restarts at
    the oldest unacknowledged event. A broker that refuses a message counts as unreachable. Each turn sends a
    window of events and a slice of an answer, so that neither delays the other for long.
    """

    def __init__(
        self,
        broker: Broker,
        topic: str,
        outbox: Outbox,
        documents: Callable[[Iterable[Entry]], Iterable[Message]],
    ) -> None:
        """Prepare to publish below `topic`, with the `documents` after a send."""
        self._broker, self._topic, self._outbox = broker, topic, outbox
        self._documents = documents
        self._replies = GapReplies(outbox, topic)
        self._retained: dict[str, Message] = {}  # by topic
        self._changed: dict[str, Message] = {}  # retained documents to publish, by topic
        self._link: Link | None = None
        self._pauses = Pauses()
        self._wake, self._closing = asyncio.Event(), False
        self._sending: BackgroundTask | None = None
        outbox.on_pending = self._wake.set

    @property
    def connected(self) -> bool:
        """True while the broker is connected and refuses nothing."""
        return bool(self._link and self._link.alive)

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
            self._link = await self._connect()
        except EndpointError:
            if connect_required:
                raise
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
        failure, pauses = "", self._pauses
        while True:
            try:
                if not (link := self._link):
                    link = self._link = await self._connect()
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
        """Connect, and send the retained documents and the oldest events: the broker may refuse them."""
        from connectors.mqtt.broker_link import connect

        link = await connect(self._broker, self._identifier, self._will, self._wake)
        self._replies.clear()
        self._changed = dict(self._retained)
        try:
            await link.listen(f"{self._topic}/replay/request")
            await self._send_pending(link)
        except BaseException:
            await link.disconnect()
            raise
        self._pauses.connected()
        return link

    async def _send_pending(self, link: "Link") -> bool:
        """Send one window of everything pending; if there is nothing, wait and return False."""
        self._wake.clear()
        while received := link.next_received():
            self._replies.request(received[1])
        entries = await self._outbox.next(WINDOW)
        replies = await self._replies.next(asyncio.get_running_loop().time())
        outgoing = [*self._changed.values(), *map(self._event, entries), *replies]
        await link.send_all(outgoing)
        self._changed.clear()
        if entries:
            self._outbox.acknowledge(entries)
            for message in self._documents(entries):
                self._retained[message.topic] = self._changed[message.topic] = message
        if not outgoing and not self._closing:
            with suppress(TimeoutError):
                async with asyncio.timeout_at(self._replies.due):
                    await self._wake.wait()
        return bool(outgoing)

    def _event(self, entry: Entry) -> Message:
        topic = f"{self._topic}/{entry.finger}/event"
        return Message(topic, entry.payload, retain=False, content_type=CONTENT_TYPE)

    async def _disconnect(self) -> None:
        if self._link:
            await self._link.disconnect()
        self._link = None
