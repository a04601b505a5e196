"""Sender of a rig: task that publishes its outbox and its retained documents."""

import asyncio
import logging
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from random import uniform
from typing import TYPE_CHECKING

from connectors.mqtt.broker import Broker, Message
from connectors.mqtt.gap_replay import GapReplies
from connectors.mqtt.outbox import Outbox
from connectors.mqtt.outbox_file import Entry
from operators.back_off import BackOff
from operators.errors import EndpointError

if TYPE_CHECKING:
    from connectors.mqtt.broker_link import Link

log = logging.getLogger("slipflow")

WINDOW = 16  # messages in flight
CLOSE_TIMEOUT = 3.0  # s, to send what is pending on close


@dataclass(slots=True)
class _Refused:
    """A topic that the broker refuses, and the message to retry first."""

    message: Message
    entry: Entry | None  # the event in the message; None: a retained document
    retry: BackOff
    due: float = 0.0  # loop time (s) of the next attempt

    def postpone(self) -> None:
        """Schedule the next attempt."""
        self.due = asyncio.get_running_loop().time() + self.retry.delay()


class Sender:
    """A task that publishes events, the retained documents they change, and answers to gap requests, in turn.

    After each connection it repeats the retained documents, which the broker may have lost, and restarts at
    the oldest unacknowledged event. A topic that the broker refuses does not delay other topics.
    """

    def __init__(
        self,
        broker: Broker,
        topic: str,
        outbox: Outbox,
        documents: Callable[[Iterable[Entry]], Iterable[Message]],
    ) -> None:
        """Prepare to publish below `topic`; `documents` returns the retained documents after a send."""
        self._broker, self._topic, self._outbox, self._documents = broker, topic, outbox, documents
        self._replies = GapReplies(outbox, topic)
        self._retained: dict[str, Message] = {}  # by topic
        self._changed: dict[str, Message] = {}  # retained documents to publish, by topic
        self._refused: dict[str, _Refused] = {}  # by topic
        self._logged = set[str]()  # topics whose refusal was logged
        self._link: Link | None = None
        self._wake, self._idle = asyncio.Event(), asyncio.Event()
        self._sending: asyncio.Task[None] | None = None
        self._reading: asyncio.Task[None] | None = None
        outbox.on_pending = self._resume

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
        self._identifier, self._will = identifier, (will.topic, will.payload)
        for message in retained:
            self._retained[message.topic] = message
        if connect_required:
            try:
                await self._connect(first=True)
            except BaseException:
                await self._disconnect()
                raise
        else:  # raise the errors that a retry cannot fix
            self._broker.login()
            if self._broker.scheme == "mqtts":
                self._broker.tls()
        self._sending = asyncio.create_task(self._keep_sending())

    def retain(self, message: Message) -> None:
        """Publish a retained document now and after each connection, until a newer one replaces it."""
        self._retained[message.topic] = self._changed[message.topic] = message
        self._resume()

    async def close(self, offline: Message) -> None:
        """Send pending messages within 3 s, publish `offline`, and disconnect."""
        if self._link and self._link.alive:
            self._link.on_lost(self._idle.set)
            with suppress(TimeoutError):
                async with asyncio.timeout(CLOSE_TIMEOUT):
                    await self._idle.wait()
        if self._sending:
            self._sending.cancel()
            await asyncio.wait([self._sending])
        if self._link and self._link.alive:
            with suppress(EndpointError):
                await self._link.send(offline.topic, offline.payload, retain=True)
        await self._disconnect()

    async def _keep_sending(self) -> None:
        failed, retry = False, BackOff()
        while True:
            try:
                if not (self._link and self._link.alive):
                    await self._disconnect()
                    await self._connect()
                if failed:
                    log.warning("%s: connected again, %d events pending", self._broker, self._outbox.waiting)
                failed = False
                retry.reset()
                while True:
                    await self._send_next()
            except Exception as error:  # noqa: BLE001 - sending continues after any error
                if not failed:
                    log.warning("%s, reconnecting; events are kept in %s", error, self._outbox.path)
                failed = True
            await asyncio.sleep(retry.delay() * uniform(0.5, 1))  # noqa: S311 - spreads clients that reconnect

    async def _connect(self, *, first: bool = False) -> None:
        from connectors.mqtt.broker_link import connect  # noqa: PLC0415 - aiomqtt takes 0.2 s to import

        self._link = link = await connect(self._broker, self._identifier, self._will)
        link.on_lost(self._wake.set)
        self._refused.clear()  # access rights may have changed
        self._replies.clear()
        self._outbox.rewind()
        self._changed = dict(self._retained)
        await self._send_changed(strict=first)
        try:
            await link.listen(f"{self._topic}/replay/request")
        except EndpointError as error:
            if not link.alive:
                raise
            self._log_once("replay/request", f"{error}; consumers cannot request missed events")
        else:
            self._reading = asyncio.create_task(self._keep_reading(link))

    async def _keep_reading(self, link: "Link") -> None:
        with suppress(EndpointError):
            while True:
                _, payload = await link.receive()
                self._replies.request(payload)
                self._wake.set()

    async def _send_next(self) -> None:
        """Send one batch of everything pending, or wait until there is something to send."""
        self._wake.clear()
        if not self._connection().alive:
            raise EndpointError(str(self._broker), "connection lost")
        entries = await self._outbox.next(WINDOW)
        if entries:
            await self._send_events(entries)
        await self._send_changed()
        await self._retry_refused()
        replies = [] if entries else await self._replies.next()
        if replies:
            await self._connection().send_all(replies)  # if refused, the client repeats its request
        if not entries and not replies and not self._replies:
            self._idle.set()
            with suppress(TimeoutError):
                async with asyncio.timeout_at(self._next_due()):
                    await self._wake.wait()

    async def _send_events(self, entries: list[Entry]) -> None:
        allowed, messages, sent = list[Entry](), list[Message](), list[Entry]()
        for entry in entries:
            message = self._event(entry)
            if message.topic in self._refused:
                self._keep_first(message.topic, entry)
            else:
                allowed.append(entry)
                messages.append(message)
        refusals = await self._connection().send_all(messages)
        for entry, message, refusal in zip(allowed, messages, refusals, strict=True):
            if refusal:
                self._refuse(message, entry, refusal)
            else:
                sent.append(entry)
        self._acknowledge(sent)

    def _acknowledge(self, sent: list[Entry]) -> None:
        if sent:
            self._outbox.acknowledge(sent)
            for message in self._documents(sent):
                self.retain(message)

    async def _send_changed(self, *, strict: bool = False) -> None:
        """Publish the changed retained documents.

        Raises:
            EndpointError: if the connection is lost, or with `strict` if one is refused.
        """
        messages = [message for topic, message in self._changed.items() if topic not in self._refused]
        for start in range(0, len(messages), WINDOW):
            window = messages[start : start + WINDOW]
            for message, refusal in zip(window, await self._connection().send_all(window), strict=True):
                if refusal and strict:
                    raise EndpointError(str(self._broker), refusal)
                if refusal:
                    self._refuse(message, None, refusal)
                elif self._changed.get(message.topic) is message:
                    del self._changed[message.topic]

    async def _retry_refused(self) -> None:
        """Send one message again on each refused topic that is due."""
        now = asyncio.get_running_loop().time()
        for topic, refused in list(self._refused.items()):
            if refused.due > now:
                continue
            message = refused.message if refused.entry else self._retained[topic]
            [refusal] = await self._connection().send_all([message])
            if refusal:
                refused.postpone()
                continue
            del self._refused[topic]
            self._logged.discard(topic)
            log.warning("%s: accepts %s again", self._broker, topic)
            if refused.entry:
                self._outbox.rewind(refused.entry.id)  # later events of this topic are pending, too
                self._acknowledge([refused.entry])
            self._wake.set()

    def _refuse(self, message: Message, entry: Entry | None, refusal: str) -> None:
        if message.topic in self._refused:
            self._keep_first(message.topic, entry)
            return
        self._refused[message.topic] = refused = _Refused(message, entry, BackOff())
        refused.postpone()
        self._log_once(message.topic, f"{self._broker}: {refusal}; retrying")

    def _keep_first(self, topic: str, entry: Entry | None) -> None:
        refused = self._refused[topic]
        if entry and refused.entry and entry.id < refused.entry.id:
            refused.message, refused.entry = self._event(entry), entry

    def _log_once(self, topic: str, text: str) -> None:
        if topic not in self._logged:
            self._logged.add(topic)
            log.warning("%s", text)

    def _event(self, entry: Entry) -> Message:
        return Message(f"{self._topic}/{entry.finger}/event", entry.payload, retain=False)

    def _resume(self) -> None:
        self._idle.clear()
        self._wake.set()

    def _next_due(self) -> float | None:
        return min((refused.due for refused in self._refused.values()), default=None)

    def _connection(self) -> "Link":
        assert self._link
        return self._link

    async def _disconnect(self) -> None:
        if self._reading:
            self._reading.cancel()
        if self._link:
            await self._link.disconnect()
        self._link = None
