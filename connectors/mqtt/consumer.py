"""Following the slip events of rigs over MQTT without missing one: for the services that act on them."""

import asyncio
import logging
import os
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from pathlib import Path
from random import uniform
from secrets import token_hex
from types import TracebackType
from typing import TYPE_CHECKING, Literal, Self

from connectors.events import Event, topic
from connectors.fields import Fields
from connectors.mqtt.broker import Broker
from connectors.mqtt.gap_request import GapAnswer, GapRequest
from connectors.mqtt.position import Place, Position, hold, load, read_heads, save
from connectors.mqtt.replay_name import is_replay
from operators.errors import EndpointError, InputError, ParameterError, SlipflowError

if TYPE_CHECKING:
    from connectors.mqtt.broker_link import Link

log = logging.getLogger("slipflow")

ASK_EVERY = 3.0  # s, until there is an answer
FIRST_RETRY = 0.1  # s
LAST_RETRY = 5.0  # s, up to which the back-off doubles


class Consumer(AsyncIterator[Event]):
    """Gives each event of the rigs that `site` and `rig` name, ``+`` standing for any, once, for ever.

    Any rig is any live one: a replay, whose events are old, is followed by its name only.

    An event is given as soon as the broker delivers it: one that was missed comes late, after newer ones.
    What the rig no longer keeps is reported as lost. So is what is malformed, and a connection that is lost,
    which is made again.

    With `position_file` it resumes from where it stopped. The position is saved when the loop asks for the
    next event: what was being worked on when the process died is given again. `Event.identifier`, kept beside
    what was made of an event, tells. A file is one consumer's at a time. A rig that is heard of for the first
    time begins ``now``, or at the ``start`` of what it keeps, as `since` says.

        async with Consumer("mqtt://localhost", site="lab", position_file="events.position") as events:
            async for event in events:
                print(event.time, event.finger, event.state)

    Raises:
        ParameterError: on a URL, a site or a rig that cannot be used.
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
        """Get ready to connect to the broker at `url`; see `connectors.mqtt.broker.Broker`."""
        self._broker = Broker.parse(url, "Consumer")
        self._topic = topic("Consumer", site, rig, wildcard="+")
        if since not in ("now", "start"):
            raise ParameterError("Consumer", "since", since, "now or start")
        self._everything, self._report = since == "start", report
        self._replays = rig != "+"  # it was named: whether it is one is for the caller to know
        self._position_file = Path(position_file) if position_file else None
        self._position = Position(everything=self._everything)
        self._held: int | None = None  # descriptor of its lock
        self._reply = f"consumer-{token_hex(6)}"  # the last level of the topic for answers
        self._link: Link | None = None
        self._dropped = 0
        self._asked: dict[tuple[Place, str], tuple[int, float]] = {}  # first number, and the newest sign (s)
        self._missed = asyncio.Event()  # it may be time to ask
        self._asking: asyncio.Task[None] | None = None
        self._saving: asyncio.Task[None] | None = None
        self._unsaved: bytes | None = None
        self._changed = False  # the position, since it was saved

    async def __aenter__(self) -> Self:
        """Read the position, and connect.

        Raises:
            EndpointError: if the broker is unreachable or refuses us, or the position cannot be read or
                written, or another consumer goes on from it.
            InputError: if the position is something else, or a file with the password cannot be read.
        """
        try:
            if self._position_file:
                self._held = await asyncio.to_thread(hold, self._position_file)
                self._position = await asyncio.to_thread(
                    load, self._position_file, everything=self._everything
                )
            await self._connect()
        except BaseException:
            self._let_go()
            raise
        self._asking = asyncio.create_task(self._keep_asking())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave; an event that was given last and not come back from is given again the next time."""
        if self._asking:
            self._asking.cancel()
            await asyncio.wait([self._asking])
        if self._saving:
            await self._saving
        self._let_go()
        await self._leave()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Event:
        """The next event, however long it takes."""
        self._finish()
        while True:
            link = await self._linked()
            try:
                place, payload = await link.receive()
            except EndpointError as error:
                self._report(f"{error}, trying again")
                await self._leave()
                continue
            if link.dropped > self._dropped:
                self._report(f"{self._broker}: {link.dropped - self._dropped} messages came too fast")
                self._dropped = link.dropped
            if not self._replays and is_replay(place.split("/")[3]):
                continue
            try:
                event = self._read(place, payload)
            except InputError as error:
                self._report(f"left out: {error}")
                continue
            self._changed = True
            if event:
                return event
            self._finish()

    def _read(self, place: str, payload: bytes) -> Event | None:
        """Take a message; gives the event that is new in it."""
        _, _, site, rig, *rest = place.split("/")
        fields, answer = Fields.parse(payload, place), ["replay", self._reply]
        if rest == ["head"]:
            self._tell(self._position.announce((site, rig), read_heads(fields)))
        elif rest == answer and "specversion" not in fields.values:
            self._settle((site, rig), GapAnswer.read(fields))
        else:
            event = Event.read(fields)
            if (event.site, event.rig) != (site, rig) or rest not in ([event.finger, "event"], answer):
                raise InputError(place, f"has an event of {event.site}/{event.rig}/{event.finger}")
            if rest == answer and (asked := self._asked.get(((site, rig), event.epoch))):
                self._asked[(site, rig), event.epoch] = asked[0], asyncio.get_running_loop().time()
            if self._position.take(event):
                self._tell(self._position.give_up())
                return event
        return None

    def _settle(self, place: Place, answer: GapAnswer) -> None:
        asked, _ = self._asked.get((place, answer.epoch), (0, 0.0))
        if asked != answer.first:  # not to what we asked last
            return
        self._tell(self._position.settle(place, answer))
        if (place, answer.epoch, asked) not in {gap[:3] for gap in self._position.gaps()}:
            del self._asked[place, answer.epoch]  # so that what is left is asked for at once

    def _tell(self, lost: list[str]) -> None:
        for report in lost:
            self._report(report)
        self._missed.set()

    async def _keep_asking(self) -> None:
        """Ask each rig for what is missed, again and again until it answers."""
        loop = asyncio.get_running_loop()
        while True:
            self._missed.clear()
            for place, epoch, first, last in list(self._position.gaps()):
                _, when = self._asked.get((place, epoch), (0, -ASK_EVERY))
                if loop.time() >= when + ASK_EVERY:
                    self._asked[place, epoch] = first, loop.time()
                    await self._ask(place, epoch, first, last)
            with suppress(TimeoutError):
                async with asyncio.timeout(ASK_EVERY):
                    await self._missed.wait()

    async def _ask(self, place: Place, epoch: str, first: int, last: int) -> None:
        rig = topic("Consumer", *place)
        request = GapRequest(epoch, first, last, f"{rig}/replay/{self._reply}")
        if self._link and self._link.alive:
            with suppress(EndpointError):  # reading notices too; it is asked again
                await self._link.send(f"{rig}/replay/request", request.encode())

    async def _linked(self) -> "Link":
        """The connection, made again if need be."""
        retry = FIRST_RETRY
        while self._link is None:
            await asyncio.sleep(retry * uniform(0.5, 1))  # noqa: S311 - so that many do not come back at once
            retry = min(2 * retry, LAST_RETRY)
            try:
                await self._connect()
            except SlipflowError as error:
                if retry > 2 * FIRST_RETRY:
                    log.debug("%s", error)
                else:
                    self._report(f"{error}, trying again")
            else:
                self._report(f"{self._broker}: connected again")
        return self._link

    async def _connect(self) -> None:
        from connectors.mqtt.broker_link import connect  # noqa: PLC0415 - aiomqtt takes 0.2 s to import

        link = await connect(self._broker, f"slipflow-{self._reply}")
        try:  # heads come last: an event before its head is no gap
            await link.listen(
                f"{self._topic}/+/event", f"{self._topic}/replay/{self._reply}", f"{self._topic}/head"
            )
        except BaseException:
            await link.leave()
            raise
        self._link, self._dropped = link, 0
        self._asked.clear()
        self._missed.set()

    async def _leave(self) -> None:
        if self._link:
            await self._link.leave()
        self._link = None

    def _let_go(self) -> None:
        if self._held is not None:
            os.close(self._held)
        self._held = None

    def _finish(self) -> None:
        """Have the position saved: what was given is done with."""
        if not (self._position_file and self._changed):
            return
        self._changed, self._unsaved = False, self._position.encode()
        if self._saving is None or self._saving.done():
            self._saving = asyncio.create_task(self._save(self._position_file))

    async def _save(self, path: Path) -> None:
        while self._unsaved is not None:  # what came meanwhile is saved at once
            payload, self._unsaved = self._unsaved, None
            try:
                await asyncio.to_thread(save, path, payload)
            except EndpointError as error:
                self._report(str(error))
