"""Sending what waits in the outbox, and what the broker should retain, whenever there is a broker."""

import asyncio
import logging
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from random import uniform
from typing import TYPE_CHECKING

from connectors.mqtt.broker import Broker
from connectors.mqtt.gap_answers import GapAnswers
from connectors.mqtt.message import Message
from connectors.mqtt.outbox import Outbox
from connectors.mqtt.outbox_file import Entry
from operators.errors import EndpointError

if TYPE_CHECKING:
    from connectors.mqtt.broker_link import Link

log = logging.getLogger("slipflow")

WINDOW = 16  # events whose answers are waited for together
FIRST_RETRY = 0.1  # s
LAST_RETRY = 5.0  # s, up to which the back-off doubles
FAREWELL = 3.0  # s, how long a closing sender goes on sending


@dataclass(slots=True)
class _Refused:
    """A topic that the broker does not let us publish on, and what is to go there first."""

    message: Message
    entry: Entry | None  # the event that it is; None: something retained
    due: float  # s, of the loop's clock, when it is tried again
    delay: float = FIRST_RETRY  # s


class Sender:
    """One task that sends, in turns: events, what they change of the retained, answers to requests.

    After each connection it first repeats what the broker should retain, for that may have forgotten, and
    begins again at the oldest event not acknowledged. A topic that the broker refuses holds up no other.
    """

    def __init__(
        self,
        broker: Broker,
        topic: str,
        outbox: Outbox,
        follow: Callable[[Iterable[Entry]], Iterable[Message]],
    ) -> None:
        """Get ready to publish below `topic`; `follow` gives what is to be retained once events were sent."""
        self._broker, self._topic, self._outbox, self._follow = broker, topic, outbox, follow
        self._answers = GapAnswers(outbox, topic)
        self._retained: dict[str, Message] = {}  # by topic
        self._changed: dict[str, Message] = {}  # those of them that the broker does not have
        self._refused: dict[str, _Refused] = {}  # by topic
        self._told = set[str]()  # topics whose refusal was logged
        self._link: Link | None = None
        self._wake, self._idle = asyncio.Event(), asyncio.Event()
        self._sending: asyncio.Task[None] | None = None
        self._reading: asyncio.Task[None] | None = None
        outbox.on_news = self._stir

    @property
    def refused(self) -> list[str]:
        """Topics that the broker refuses."""
        return sorted(self._refused)

    async def start(
        self, identifier: str, will: Message, *retained: Message, connect_required: bool = True
    ) -> None:
        """Connect, publish what is to be retained, and begin to send.

        Raises:
            EndpointError: if the broker is unreachable or refuses, unless `connect_required` is false.
            InputError: if a file with the password or the authorities cannot be read.
        """
        self._identifier, self._will = identifier, (will.topic, will.payload)
        for message in retained:
            self._retained[message.topic] = message
        if not connect_required:  # only what a person must mend is told now
            self._broker.login()
            if self._broker.scheme == "mqtts":
                self._broker.tls()
        else:
            try:
                await self._connect(first=True)
            except BaseException:
                await self._leave()
                raise
        self._sending = asyncio.create_task(self._keep_sending())

    def retain(self, message: Message) -> None:
        """Publish soon, and again after each connection, until there is something newer for its topic."""
        self._retained[message.topic] = self._changed[message.topic] = message
        self._stir()

    async def close(self, farewell: Message) -> None:
        """Send what still can be, say farewell and leave; if the connection is lost, the will has to do."""
        if self._link and self._link.alive:
            self._link.on_lost(self._idle.set)
            with suppress(TimeoutError):
                async with asyncio.timeout(FAREWELL):
                    await self._idle.wait()
        if self._sending:
            self._sending.cancel()
            await asyncio.wait([self._sending])
        if self._link and self._link.alive:
            with suppress(EndpointError):
                await self._link.send(farewell.topic, farewell.payload, retain=True)
        await self._leave()

    async def _keep_sending(self) -> None:
        failed, retry = False, FIRST_RETRY
        while True:
            try:
                if not (self._link and self._link.alive):
                    await self._leave()
                    await self._connect()
                if failed:
                    log.warning("%s: connected again, %d events wait", self._broker, self._outbox.waiting)
                failed, retry = False, FIRST_RETRY
                while True:
                    await self._turn()
            except Exception as error:  # noqa: BLE001 - whatever happens, alerts go on
                if not failed:
                    log.warning("%s, trying again; events wait in %s", error, self._outbox.path)
                failed = True
            await asyncio.sleep(retry * uniform(0.5, 1))  # noqa: S311 - so that many do not come back at once
            retry = min(2 * retry, LAST_RETRY)

    async def _connect(self, *, first: bool = False) -> None:
        from connectors.mqtt.broker_link import connect  # noqa: PLC0415 - aiomqtt takes 0.2 s to import

        self._link = link = await connect(self._broker, self._identifier, self._will)
        link.on_lost(self._wake.set)
        self._refused.clear()  # a broker that was away may have learned
        self._answers.forget()
        self._outbox.rewind()
        self._changed = dict(self._retained)
        await self._send_changed(strictly=first)
        try:
            await link.listen(f"{self._topic}/replay/request")
        except EndpointError as error:
            if not link.alive:
                raise
            self._tell("replay/request", f"{error}; nobody can ask for events that did not come")
        else:
            self._reading = asyncio.create_task(self._keep_reading(link))

    async def _keep_reading(self, link: "Link") -> None:
        with suppress(EndpointError):
            while True:
                _, payload = await link.receive()
                self._answers.ask(payload)
                self._wake.set()

    async def _turn(self) -> None:
        """Send some of what there is to send, or wait for it."""
        self._wake.clear()
        if not self._linked().alive:
            raise EndpointError(str(self._broker), "connection lost")
        entries = await self._outbox.next(WINDOW)
        if entries:
            await self._send_events(entries)
        await self._send_changed()
        await self._try_refused()
        answers = [] if entries else await self._answers.next()
        if answers:
            await self._linked().send_all(answers)  # who is refused what was asked for asks again
        if not entries and not answers and not self._answers:
            self._idle.set()
            with suppress(TimeoutError):
                async with asyncio.timeout_at(self._due()):
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
        refusals = await self._linked().send_all(messages)
        for entry, message, refusal in zip(allowed, messages, refusals, strict=True):
            if refusal:
                self._refuse(message, entry, refusal)
            else:
                sent.append(entry)
        self._confirm(sent)

    def _confirm(self, sent: list[Entry]) -> None:
        if sent:
            self._outbox.acknowledge(sent)
            for message in self._follow(sent):
                self.retain(message)

    async def _send_changed(self, *, strictly: bool = False) -> None:
        """Publish what is to be retained; `strictly`: being refused is an error."""
        messages = [message for topic, message in self._changed.items() if topic not in self._refused]
        for start in range(0, len(messages), WINDOW):
            some = messages[start : start + WINDOW]
            for message, refusal in zip(some, await self._linked().send_all(some), strict=True):
                if refusal and strictly:
                    raise EndpointError(str(self._broker), refusal)
                if refusal:
                    self._refuse(message, None, refusal)
                elif self._changed.get(message.topic) is message:
                    del self._changed[message.topic]

    async def _try_refused(self) -> None:
        """Try again one thing for each topic that the broker refused, when it is time."""
        now = asyncio.get_running_loop().time()
        for topic, refused in list(self._refused.items()):
            if refused.due > now:
                continue
            message = refused.message if refused.entry else self._retained[topic]
            [refusal] = await self._linked().send_all([message])
            if refusal:
                refused.delay = min(2 * refused.delay, LAST_RETRY)
                refused.due = now + refused.delay
                continue
            del self._refused[topic]
            self._told.discard(topic)
            log.warning("%s: lets us publish %s again", self._broker, topic)
            if refused.entry:
                self._outbox.rewind(refused.entry.id)  # those behind it wait too
                self._confirm([refused.entry])
            self._wake.set()

    def _refuse(self, message: Message, entry: Entry | None, refusal: str) -> None:
        if message.topic in self._refused:
            self._keep_first(message.topic, entry)
            return
        due = asyncio.get_running_loop().time() + FIRST_RETRY
        self._refused[message.topic] = _Refused(message, entry, due)
        self._tell(message.topic, f"{self._broker}: {refusal}; trying again")

    def _keep_first(self, topic: str, entry: Entry | None) -> None:
        refused = self._refused[topic]
        if entry and refused.entry and entry.id < refused.entry.id:
            refused.message, refused.entry = self._event(entry), entry

    def _tell(self, topic: str, text: str) -> None:
        if topic not in self._told:
            self._told.add(topic)
            log.warning("%s", text)

    def _event(self, entry: Entry) -> Message:
        return Message(f"{self._topic}/{entry.finger}/event", entry.payload, retain=False)

    def _stir(self) -> None:
        self._idle.clear()
        self._wake.set()

    def _due(self) -> float | None:
        return min((refused.due for refused in self._refused.values()), default=None)

    def _linked(self) -> "Link":
        assert self._link
        return self._link

    async def _leave(self) -> None:
        if self._reading:
            self._reading.cancel()
        if self._link:
            await self._link.leave()
        self._link = None
