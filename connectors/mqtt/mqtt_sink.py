"""Sink that publishes slip events and the state of the rig over MQTT 5."""

import asyncio
import logging
from collections.abc import AsyncGenerator, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
from msgspec.structs import asdict

from connectors.events import Event, Fault, Model, encode, faults, finger_name, slips, timestamp
from connectors.mqtt.broker import Broker, Message
from connectors.mqtt.outbox import Outbox
from connectors.mqtt.outbox_log import Entry
from connectors.mqtt.rig_names import host_rig, outbox_path, rig_topic
from connectors.mqtt.sender import Sender
from operators.batch import Faults, Slips, ms
from operators.checks import check_between, check_whole
from operators.errors import ParameterError
from operators.extras import software_version
from operators.ports import Clock, Finding, Json, Run, Sink
from storage.files import check_disk

log = logging.getLogger("slipflow")


@dataclass(eq=False)
class Mqtt(Sink[Slips | Faults]):
    """Slip events and the state of each fingertip over MQTT 5, without losing an event.

    Events are numbered and stored in the outbox, a folder that is kept between runs, before they are sent.
    They are sent until the broker acknowledges them, in a later run if necessary, with the same id. A power
    cut loses at most the newest events that are neither sent nor on disk. While the disk is full or fails,
    events are sent from memory, and a kill may lose them. Faults mark later events as degraded.

    Args:
        url: Address of the broker, see `connectors.mqtt.broker.Broker`.
        site: Name of the site in the topics.
        rig: Name of the rig, unique within the site; empty: name of this host.
        model: ``id`` and ``sha256`` of the detector, for the events.
        threshold: Probability from which a sample counts as slip, for the events.
        consecutive: Decisions that start a slip, for the events.
        outbox: Folder; None: one per site and rig in $XDG_STATE_HOME/slipflow.
        connect_required: False: start also without the broker; events wait in the outbox.

    Raises:
        ParameterError: if a parameter is out of range.
    """

    live_only = True

    url: str
    site: str = "lab"
    rig: str = ""
    model: Mapping[str, str] = field(default_factory=dict[str, str])
    threshold: float | None = None
    consecutive: int | None = None
    outbox: str | Path | None = None
    connect_required: bool = True

    def __post_init__(self) -> None:
        self._broker, self.rig = Broker.parse(self.url), self.rig or host_rig()
        self._topic = rig_topic("Mqtt", self.site, self.rig)
        self._path = outbox_path(self.site, self.rig) if self.outbox is None else Path(self.outbox)
        try:
            self._model = msgspec.convert(asdict(Model(**{"id": "unknown", **self.model})), Model)
        except (TypeError, ValueError):
            must_be = "a mapping with a printable id and a sha256 of 64 digits 0-9 a-f"
            raise ParameterError("Mqtt", "model", dict(self.model), must_be) from None
        if self.threshold is not None:
            check_between("Mqtt", "threshold", self.threshold, 0, 1)
            self.threshold = float(self.threshold)  # of numpy, which is not JSON
        if self.consecutive is not None:
            check_whole("Mqtt", "consecutive", self.consecutive, 1)
            self.consecutive = int(self.consecutive)

    @property
    def destination(self) -> str:
        """Broker and topic."""
        return f"{self._broker}/{self._topic}"

    @property
    def pending(self) -> int:
        """Events that are neither in the outbox nor acknowledged by the broker."""
        return self._outbox.unstored

    @property
    def waiting(self) -> int:
        """Events that the broker has not acknowledged."""
        return self._outbox.waiting

    @property
    def connected(self) -> bool:
        """True while the broker is connected and refuses nothing."""
        return self._sender.connected

    async def diagnose(self, clock: Clock) -> AsyncGenerator[Finding]:
        """Check the disk of the outbox, and the broker by one message on the topic ``doctor`` of the rig."""
        from connectors.mqtt.broker_link import diagnose_broker

        for finding in await asyncio.to_thread(check_disk, self._path):
            yield finding
        async for finding in diagnose_broker(self._broker, f"{self._topic}/doctor", clock):
            yield finding

    async def open(self, run: Run) -> None:
        """Open the outbox, connect, and publish the retained documents.

        Raises:
            EndpointError: if another run uses the outbox, or with `connect_required` if the broker is
                unreachable or refuses the client.
            InputError: if the outbox is another kind of file, or a file with credentials cannot be read.
        """
        self._run = run
        self._faults: dict[str, set[Fault]] = {}  # by finger
        self._outbox = Outbox(self._path)
        await self._outbox.open()
        # the same in each run, so that a new connection cancels the previous will
        identifier = f"slipflow/{self.site}/{self.rig}"
        self._sender = Sender(self._broker, self._topic, self._outbox, self._documents, self._report)
        online = self._status("online", run.clock.now())
        try:
            documents = online, self._head(), self._report(), *self._no_slips()
            will = self._status("offline", None)
            await self._sender.start(identifier, will, *documents, connect_required=self.connect_required)
        except BaseException:
            await self._outbox.close()
            raise

    async def write(self, batch: Slips | Faults) -> None:
        """Store the events of a batch in the outbox, or raise EndpointError if disk and memory fail."""
        if isinstance(batch, Faults):
            known = self._faults.setdefault(finger_name(batch.finger), set())
            for _, fault, begins in faults(batch):
                (known.add if begins else known.discard)(fault)
        else:
            await self._outbox.append(list(self._events(batch)))

    async def close(self) -> None:
        """Send pending events within 3 s, publish states without slip and the offline status, disconnect."""
        try:
            await self._sender.close(*self._no_slips(), self._status("offline", self._run.clock.now()))
        finally:
            try:
                await self._outbox.close()
            finally:
                if unsent := self._outbox.waiting - self._outbox.unstored:
                    text = "%s: %d unsent events remain in %s; the next run sends them"
                    log.warning(text, self._broker, unsent, self._outbox.path)

    def _degraded(self, finger: str) -> tuple[Fault, ...]:
        return tuple(sorted(self._faults.get(finger, ()), key=lambda fault: (fault.barometer, fault.kind)))

    def _events(self, batch: Slips) -> Iterator[Event]:
        """Yield the events of a batch; the outbox sets their epoch and number."""
        finger = finger_name(batch.finger)
        for slip in slips(batch):
            latency = self._run.latency(slip.time)
            yield Event(
                site=self.site,
                rig=self.rig,
                finger=finger,
                epoch="",
                seq=0,
                state="onset" if slip.onset else "end",
                time=slip.time,
                probability=slip.probability,
                latency=None if latency is None else latency / ms,
                threshold=self.threshold,
                consecutive=self.consecutive,
                model=self._model,
                degraded=self._degraded(finger),
                session=self._run.session,
            )

    def _documents(self, sent: Iterable[Entry]) -> Iterator[Message]:
        """Yield the retained documents that sent events change: head, and states, but not for a past run."""
        newest = {entry.finger: entry for entry in sent if entry.epoch == self._outbox.epoch}
        for entry in newest.values():
            yield self._state(Event.decode(entry.payload))
        yield self._head()

    def _no_slips(self) -> Iterator[Message]:
        """Yield the states of the fingertips before the first event of a run and after its end."""
        now, epoch = self._run.clock.now(), self._outbox.epoch
        for finger in map(finger_name, self._run.sink_types.get(self.destination, {}).get(Slips, ())):
            about = Event(
                finger=finger, epoch=epoch, seq=0, state="end", time=now, probability=None, latency=None
            )
            yield self._state(about)

    def _state(self, event: Event) -> Message:
        state: dict[str, Json] = {
            "slip": event.onset,
            "p": event.probability,
            "quality": event.quality,
            "since": timestamp(event.time),
            "epoch": event.epoch,
            "seq": event.seq,
        }
        return self._message(f"{event.finger}/state", state)

    def _message(self, name: str, document: dict[str, Json]) -> Message:
        return Message(f"{self._topic}/{name}", encode(document))

    def _about_run(self, name: str, **document: Json) -> Message:
        """Return a document with epoch and session."""
        return self._message(name, {"epoch": self._outbox.epoch, "session": self._run.session, **document})

    def _status(self, state: str, since: int | None) -> Message:
        when = None if since is None else timestamp(since)  # unknown for a will
        return self._about_run("status", state=state, version=software_version(), since=when)

    def _head(self) -> Message:
        heads = self._outbox.heads()
        *before, head = [dict[str, Json](epoch=each, last_seq=last) for each, last in heads]
        return self._message("head", {**head, "before": before} if before else head)

    def _report(self) -> Message:
        outbox: dict[str, Json] = {
            "error": self._outbox.error or None,
            "waiting": self._outbox.waiting,
            "refused": self._sender.refused,
        }
        faults: dict[str, Json] = {
            finger: [asdict(each) for each in self._degraded(finger)] for finger in self._faults
        }
        return self._about_run("health", **health(self._run), degraded=faults, outbox=outbox)


def health(run: Run) -> dict[str, Json]:
    """Return the time, and the sources: each ``up``, ``stale`` (for `Source.stale_after`) or ``down``."""
    now = run.clock.now()
    sources: dict[str, Json] = {
        name: {
            "state": "up" if source.up else "stale" if source.stale else "down",
            "lag_ms": (now - source.newest) / ms if source.newest else None,
            "rows": source.rows,
        }
        for name, source in run.sources.items()
    }
    return {"time_ns": now, "sources": sources}
