"""Consumer of slip events over MQTT that delivers each event once and fetches the ones it missed."""

import asyncio
import logging
import os
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from random import uniform
from secrets import token_hex
from types import TracebackType
from typing import TYPE_CHECKING, Literal, Self

from connectors.events import Event
from connectors.fields import Fields
from connectors.mqtt.broker import Broker, Message
from connectors.mqtt.gap_replay import GapAnswer, GapRequest
from connectors.mqtt.position import Position, RigId, load, lock_position, read_heads
from connectors.mqtt.rig_names import NAME_MAX, is_replay, is_topic_level, rig_topic
from operators.back_off import BackOff
from operators.checks import check_choice
from operators.errors import EndpointError, InputError, SlipflowError, os_error_reason
from storage.background_task import BackgroundTask
from storage.files import put

if TYPE_CHECKING:
    from connectors.mqtt.broker_link import Link

log = logging.getLogger("slipflow")

REQUEST_EVERY = 3.0  # s, until an answer arrives


class Consumer(AsyncIterator[Event]):
    """Slip events of the rigs that match `site` and `rig`, each once; ``+`` matches any live rig.

    A replay publishes old events, so it is followed only if `rig` is its full name.

    Events arrive as soon as the broker delivers them; a missed event is fetched from the rig and arrives
    late, after newer ones. Events that the rig no longer keeps are reported as lost. Malformed messages and
    lost connections are reported too; the consumer reconnects.

    With `position_file` it resumes at the saved position. The position is saved when the loop requests the
    next event, so after a crash the event in progress is delivered again: deduplicate on `Event.identifier`.
    One consumer at a time can use a file. The events of a new rig start with its next one (``since="now"``),
    or with the oldest that it keeps (``since="start"``).

        async with Consumer("mqtt://localhost", site="lab", position_file="events.position") as events:
            async for event in events:
                print(event.time, event.finger, event.state)

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
        """Prepare a connection to the broker at `url`, see `connectors.mqtt.broker.Broker`; `report` logs."""
        self._broker = Broker.parse(url, "Consumer")
        self._topic = rig_topic("Consumer", site, rig, wildcard="+")
        check_choice("Consumer", "since", since, ("now", "start"))
        self._everything, self._report = since == "start", report
        self._with_replays = rig != "+"
        self._position_file = Path(position_file) if position_file else None
        self._position = Position(everything=self._everything)
        self._lock: int | None = None  # descriptor
        self._reply_name = f"consumer-{token_hex(6)}"  # last level of the topic for replies
        self._link: Link | None = None
        self._dropped = 0
        # first number and time (s) of the latest request, by rig and epoch
        self._requested: dict[tuple[RigId, str], tuple[int, float]] = {}
        self._check_due = 0.0  # loop time (s) of the next check for gaps
        self._saving: BackgroundTask | None = None
        self._unsaved: bytes | None = None
        self._changed = False  # the position changed since it was saved

    async def __aenter__(self) -> Self:
        """Load the position and connect.

        Raises:
            EndpointError: if the broker is unreachable or refuses the connection, or the position file cannot
                be read or written or is in use.
            InputError: if the file is not a position file, or a file with credentials cannot be read.
        """
        try:
            if path := self._position_file:
                self._lock = lock_position(path)  # not in a thread: a cancelled wait would leave it locked
                self._position = await asyncio.to_thread(load, path, everything=self._everything)
            self._link = await self._connect()
        except BaseException:
            self._unlock()
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Disconnect; the next run delivers an event in progress again.

        Raises:
            EndpointError: if the saving of the position has failed, other than by a failure of the disk.
        """
        try:
            if self._saving:
                await self._saving.end(None)
        finally:
            self._unlock()
            await self._disconnect()
        if self._saving:
            self._saving.check()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Event:
        """Return the next event; wait as long as necessary."""
        self._mark_done()
        while True:
            link = self._link or await self._reconnect()
            if asyncio.get_running_loop().time() >= self._check_due:
                self._request_missed(link)
            try:
                async with asyncio.timeout_at(self._check_due):
                    topic, payload = await link.receive()
            except TimeoutError:
                continue
            except EndpointError as error:
                self._report(f"{error}, reconnecting")
                await self._disconnect()
                continue
            if link.dropped > self._dropped:
                dropped, self._dropped = link.dropped - self._dropped, link.dropped
                self._report(f"{self._broker}: {dropped} messages dropped: the consumer is too slow")
            try:
                event = self._process(topic, payload)
            except InputError as error:
                self._report(f"ignoring malformed message: {error}")
                continue
            if event:
                return event
            self._mark_done()

    def _process(self, topic: str, payload: bytes) -> Event | None:
        """Process a message; return its event if the event is new."""
        _, _, site, rig, *rest = topic.split("/")
        if not (topic.isprintable() and is_topic_level(site) and is_topic_level(rig)):
            reason = f"site and rig of a topic must be printable text of 1 to {NAME_MAX} characters"
            raise InputError(f"{topic!a:.200}", reason)
        if is_replay(rig) and not self._with_replays:
            return None
        fields, reply = Fields.parse(payload, topic), ["replay", self._reply_name]
        self._changed = True
        if rest == ["head"]:
            lost = self._position.announce((site, rig), read_heads(fields))
            self._report_lost([*lost, *self._position.give_up()])
        elif rest == reply and "specversion" not in fields.values:
            self._settle((site, rig), GapAnswer.read(fields))
        else:
            event = Event.read(fields)
            if (event.site, event.rig) != (site, rig) or rest not in ([event.finger, "event"], reply):
                raise InputError(topic, f"has an event of {event.site}/{event.rig}/{event.finger}")
            if self._position.take(event):
                self._report_lost(self._position.give_up())
                return event
        return None

    def _settle(self, rig: RigId, answer: GapAnswer) -> None:
        first, _ = self._requested.get((rig, answer.epoch), (0, 0.0))
        if first != answer.first:  # an answer to an earlier request
            return
        self._report_lost(self._position.settle(rig, answer))
        if (rig, answer.epoch, first) not in {gap[:3] for gap in self._position.gaps()}:
            del self._requested[rig, answer.epoch]  # request the rest at once

    def _report_lost(self, lost: list[str]) -> None:
        for text in lost:
            self._report(text)
        self._check_due = 0.0

    def _request_missed(self, link: "Link") -> None:
        """Request missed events from each rig; repeat a request if the rig has not answered for 3 s."""
        now = asyncio.get_running_loop().time()
        self._check_due = now + REQUEST_EVERY
        for rig, epoch, first, last in self._position.gaps():
            _, when = self._requested.get((rig, epoch), (0, now - REQUEST_EVERY))
            if now >= when + REQUEST_EVERY:
                self._requested[rig, epoch] = first, now
                topic = rig_topic("Consumer", *rig)
                request = GapRequest(epoch, first, last, f"{topic}/replay/{self._reply_name}")
                link.post(Message(f"{topic}/replay/request", request.encode(), retain=False))

    async def _reconnect(self) -> "Link":
        retry, failures = BackOff(), 0
        while self._link is None:
            await asyncio.sleep(retry.delay() * uniform(0.5, 1))  # noqa: S311 - spreads clients that reconnect
            try:
                self._link = await self._connect()
            except SlipflowError as error:
                failures += 1
                (self._report if failures == 1 else log.debug)(f"{error}, reconnecting")
            else:
                self._report(f"{self._broker}: connected again")
        return self._link

    async def _connect(self) -> "Link":
        from connectors.mqtt.broker_link import connect  # noqa: PLC0415 - aiomqtt takes 0.2 s to import

        link = await connect(self._broker, f"slipflow-{self._reply_name}")
        try:  # heads last, so that an event in flight does not look like a gap
            await link.listen(
                f"{self._topic}/+/event", f"{self._topic}/replay/{self._reply_name}", f"{self._topic}/head"
            )
        except BaseException:
            await link.disconnect()
            raise
        self._dropped, self._check_due = 0, 0.0
        self._requested.clear()
        return link

    async def _disconnect(self) -> None:
        if self._link:
            await self._link.disconnect()
        self._link = None

    def _unlock(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
        self._lock = None

    def _mark_done(self) -> None:
        """Mark the latest event as processed, and start saving the position."""
        if self._saving:
            self._saving.check()
        if not (self._position_file and self._changed):
            return
        self._unsaved, forgotten = self._position.encode_limited()
        self._changed = False
        for text in forgotten:
            self._report(text)
        if self._saving is None or self._saving.done:
            path = self._position_file
            purpose = "the saving of the position"
            self._saving = BackgroundTask(str(path), purpose, self._save(path), endless=False)

    async def _save(self, path: Path) -> None:
        while self._unsaved is not None:  # save again what changed meanwhile
            payload, self._unsaved = self._unsaved, None
            try:
                await asyncio.to_thread(put, path, payload)
            except OSError as error:
                self._report(f"{path}: cannot be written: {os_error_reason(error)}")
