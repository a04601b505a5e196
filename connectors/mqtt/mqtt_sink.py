"""Publishing slip events, and how the rig is doing, over MQTT 5."""

import asyncio
import logging
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path

from connectors.events import Event, Fault, encode, faults, finger_name, timestamp, topic
from connectors.health_report import HealthReports, clock_report
from connectors.mqtt.broker import Broker
from connectors.mqtt.message import Message
from connectors.mqtt.outbox import Outbox
from connectors.mqtt.outbox_file import Entry
from connectors.mqtt.outbox_place import default_path, of_replays
from connectors.mqtt.replay_name import name_in, replay_name
from connectors.mqtt.sender import Sender
from operators.batch import SLIP, Clocks, Faults, Slips, ms
from operators.errors import ParameterError
from operators.ports import Json, Run, Sink

log = logging.getLogger("slipflow")

HEALTH_EVERY = 5.0  # s


@dataclass(eq=False)
class Mqtt(Sink[Slips | Faults | Clocks]):
    """Publishes each slip event once it is decided, losing none, and keeps the state of every fingertip.

    An event is numbered and in the outbox, a file that outlives the run, before it is sent, and it is sent
    until the broker has it: in a later run, if need be. A power cut costs at most the events of the last
    moments that are neither out nor on the disk yet. Whoever missed an event can ask for it, see
    `connectors.mqtt.consumer.Consumer`.

    Topics below ``slip/v1/<site>/<rig>``, all with QoS 1, all but the events retained:

    - ``<finger>/event``: one CloudEvent per onset and end, see `connectors.events.Event`
    - ``<finger>/state``: whether it slips
    - ``head``: the number of the newest event, in the present epoch and in those ``before``
    - ``status``: online or offline, the latter as last will too
    - ``info``: what runs; ``health``: how it does

    An event that is published again has the same id. While the disk is full or fails, events are sent from
    memory, in an epoch of their own, and written down when it works; killed meanwhile, they may be lost.
    Faults mark the events that come after them, and show in the health; so do outbox and device clocks.

    A replay publishes as another rig, ``<rig>-replay``, from an outbox of its own: whoever follows the rig
    hears nothing of it, and both may run at once. No live rig may be so called.

    Raises:
        ParameterError: on a value that cannot be used.
    """

    url: str  # see `connectors.mqtt.broker.Broker`
    site: str = "lab"
    rig: str = "rig"  # with the site: two runs may not publish as the same one
    model: Mapping[str, str] = field(default_factory=dict[str, str])  # id and sha256 of the detector
    threshold: float | None = None  # of the probability, for the events to tell
    consecutive: int | None = None  # samples that decide an onset, for the events to tell
    outbox: str | Path | None = None  # None: a file per site and rig below $XDG_STATE_HOME/slipflow
    keep: int = 100_000  # events, for those who missed them
    keep_for: float = 7 * 86400  # s
    connect_required: bool = True  # False: start without the broker; events wait in the outbox

    def __post_init__(self) -> None:
        self._broker = Broker.parse(self.url)
        self._place = f"{self._broker}/{topic('Mqtt', self.site, self.rig)}"
        self._model, self._sha256 = self.model.get("id", "unknown"), self.model.get("sha256")
        named = self._model and self._model.isprintable() and not set(self.model) - {"id", "sha256"}
        if not named or (self._sha256 is not None and not re.fullmatch("[0-9a-f]{64}", self._sha256)):
            must_be = "a mapping with a printable id and a sha256 of 64 digits 0-9 a-f"
            raise ParameterError("Mqtt", "model", dict(self.model), must_be)
        if not 0 <= (self.threshold or 0) <= 1:
            raise ParameterError("Mqtt", "threshold", self.threshold, "from 0 to 1")
        if self.consecutive is not None and self.consecutive < 1:
            raise ParameterError("Mqtt", "consecutive", self.consecutive, "at least 1")
        if self.keep < 1:
            raise ParameterError("Mqtt", "keep", self.keep, "at least 1")
        if not self.keep_for > 0:
            raise ParameterError("Mqtt", "keep_for", self.keep_for, "more than 0 s")

    @property
    def destination(self) -> str:
        """Broker and topic."""
        return self._place

    @property
    def replay_destination(self) -> str:
        """Broker and topic in a replay."""
        return f"{self._broker}/{topic('Mqtt', self.site, replay_name(self.rig))}"

    async def open(self, run: Run) -> None:
        """Open the outbox, connect, and say that we are online.

        Raises:
            EndpointError: if the broker is unreachable or refuses us, with `connect_required`, or another
                run uses the outbox.
            InputError: if the outbox is no outbox, or a file with the password cannot be read.
            ParameterError: if the rig is live and called as a replay.
        """
        self._run, self._name = run, name_in(run, "Mqtt", self.rig)
        self._topic = topic("Mqtt", self.site, self._name)
        self._faults: dict[str, set[Fault]] = {}  # by finger
        self._health = HealthReports(run)
        self._clock: dict[str, Json] | None = None  # how a device's clock stood last
        self._told: dict[str, int] = {}  # ids of the events whose state was published last, by finger
        self._outbox = Outbox(self._outbox_path(), keep=self.keep, keep_for=self.keep_for)
        await self._outbox.open()
        # The same in each run: a new one disarms an old will. That of a replay cuts off no live rig.
        identifier = f"slipflow/{self.site}/{self._name}"
        self._sender = Sender(self._broker, self._topic, self._outbox, self._follow)
        online = self._status("online", run.clock.now())
        try:
            documents = online, self._info(), self._head(), self._report()
            will = self._status("offline", None)
            await self._sender.start(identifier, will, *documents, connect_required=self.connect_required)
        except BaseException:
            await self._outbox.close()
            raise
        self._reporting = asyncio.create_task(self._keep_reporting())

    async def write(self, batch: Slips | Faults | Clocks) -> None:
        """Put the events of a batch into the outbox, from which they are sent as soon as may be.

        Raises:
            EndpointError: if neither the disk nor memory takes them.
        """
        if isinstance(batch, Faults):
            known = self._faults.setdefault(finger_name(batch.finger), set())
            for _, fault, begins in faults(batch):
                (known.add if begins else known.discard)(fault)
        elif isinstance(batch, Clocks):
            self._clock = clock_report(batch)
        else:
            await self._outbox.append(list(self._events(batch)))

    async def close(self) -> None:
        """Send what still can be, say that we are offline, and leave; the rest waits for the next run."""
        self._reporting.cancel()
        await asyncio.wait([self._reporting])
        await self._sender.close(self._status("offline", self._run.clock.now()))
        if self._outbox.waiting:
            text = "%s: %d events wait in %s for the next run"
            log.warning(text, self._broker, self._outbox.waiting, self._outbox.path)
        await self._outbox.close()

    def _outbox_path(self) -> Path:
        if self.outbox is None:
            return default_path(self.site, self._name)
        return Path(self.outbox) if self._run.recording is None else of_replays(Path(self.outbox))

    def _degraded(self, finger: str) -> tuple[Fault, ...]:
        return tuple(sorted(self._faults.get(finger, ()), key=lambda fault: (fault.barometer, fault.kind)))

    def _events(self, batch: Slips) -> Iterator[Event]:
        """The events of a batch, whose epoch and number the outbox gives."""
        finger = finger_name(batch.finger)
        rows = zip(batch.time.tolist(), batch.state.tolist(), batch.probability.tolist(), strict=True)
        for time, state, probability in rows:
            latency = self._run.latency(time)
            yield Event(
                self.site,
                self._name,
                finger,
                "",
                0,
                onset=state == SLIP,
                time=time,
                probability=probability,
                latency=None if latency is None else latency / ms,
                threshold=self.threshold,
                consecutive=self.consecutive,
                model=self._model,
                sha256=self._sha256,
                degraded=self._degraded(finger),
                session=self._run.session,
            )

    def _follow(self, sent: Iterable[Entry]) -> Iterator[Message]:
        """What is to be retained once events were sent: the state of their fingertips, and the head."""
        newest = {entry.finger: entry for entry in sent}
        for finger, entry in newest.items():
            if entry.id > self._told.get(finger, 0):  # it may have waited for long
                self._told[finger] = entry.id
                yield self._state(Event.decode(entry.payload))
        yield self._head()

    def _message(self, name: str, document: dict[str, Json]) -> Message:
        return Message(f"{self._topic}/{name}", encode(document))

    def _state(self, event: Event) -> Message:
        state: dict[str, Json] = {"slip": event.onset, "p": event.probability}
        since: dict[str, Json] = {"since": timestamp(event.time), "epoch": event.epoch, "seq": event.seq}
        return self._message(f"{event.finger}/state", {**state, **since})

    def _identity(self) -> dict[str, Json]:
        return {"epoch": self._outbox.epoch, "session": self._run.session}

    def _status(self, state: str, since: int | None) -> Message:
        document: dict[str, Json] = {
            "version": version("slipflow"),
            "since": None if since is None else timestamp(since),  # a will cannot know
        }
        return self._message("status", {"state": state, **self._identity(), **document})

    def _info(self) -> Message:
        document: dict[str, Json] = {
            "flow": self._run.flow,
            "recording": self._run.recording,
            "sources": {
                name: {key: value for key, value in description.items() if key != "episodes"}  # they go on
                for name, description in self._run.describe.items()
            },
            "model": {"id": self._model, "sha256": self._sha256},
            "threshold": self.threshold,
            "consecutive": self.consecutive,
            "units": {"p": "1", "sample_time_ns": "ns", "latency_ms": "ms"},
        }
        return self._message("info", {**self._identity(), **document})

    def _head(self) -> Message:
        *before, (epoch, last) = self._outbox.heads()
        document: dict[str, Json] = {"epoch": epoch, "last_seq": last}
        if before:
            document["before"] = [{"epoch": epoch, "last_seq": last} for epoch, last in before]
        return self._message("head", document)

    def _report(self) -> Message:
        degraded: dict[str, Json] = {
            finger: [asdict(fault) for fault in self._degraded(finger)] for finger in self._faults
        }
        refused: list[Json] = [*self._sender.refused]
        outbox: dict[str, Json] = {"error": self._outbox.error or None, "waiting": self._outbox.waiting}
        report = {**self._identity(), **self._health.next(), "degraded": degraded, "clock": self._clock}
        return self._message("health", {**report, "outbox": {**outbox, "refused": refused}})

    async def _keep_reporting(self) -> None:
        while True:
            await asyncio.sleep(HEALTH_EVERY)
            self._sender.retain(self._report())
