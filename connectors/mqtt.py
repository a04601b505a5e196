"""Publishing slip events, and how the rig is doing, over MQTT 5."""

import asyncio
import logging
import re
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import version

from connectors.broker import Broker
from connectors.events import Event, Fault, encode, faults, finger_name, timestamp, topic
from connectors.health_report import HealthReports, clock_report
from connectors.publisher import Message, Publisher
from operators.batch import SLIP, Batch, Clocks, Faults, Slips, ms
from operators.errors import ParameterError, SlipflowError
from operators.ports import Json, Run, Sink

log = logging.getLogger("slipflow")

HEALTH_EVERY = 5.0  # s


@dataclass(eq=False)
class Mqtt(Sink[Slips | Faults | Clocks]):
    """Publishes each slip event once it is decided, and keeps the state of every fingertip on the broker.

    Topics below ``slip/v1/<site>/<rig>``, all with QoS 1, all but the events retained:

    - ``<finger>/event``: one CloudEvent per onset and end, see `connectors.events.Event`
    - ``<finger>/state``: whether it slips
    - ``head``: the number of the newest event
    - ``status``: online or offline, the latter as last will too
    - ``info``: what runs; ``health``: how it does

    An event that is published again, because the broker's answer to the first was lost, has the same id.
    Faults mark the events that come after them, and show in the health; so does how a device's clock stands.

    Raises:
        ParameterError: on a value that cannot be used.
    """

    url: str  # see `connectors.broker.Broker`
    site: str = "lab"
    rig: str = "rig"  # with the site: two runs may not publish as the same one
    model: Mapping[str, str] = field(default_factory=dict[str, str])  # id and sha256 of the detector
    threshold: float | None = None  # of the probability, for the events to tell
    consecutive: int | None = None  # samples that decide an onset, for the events to tell

    def __post_init__(self) -> None:
        self._broker = Broker.parse(self.url)
        self._topic = topic("Mqtt", self.site, self.rig)
        self._model, self._sha256 = self.model.get("id", "unknown"), self.model.get("sha256")
        named = self._model and self._model.isprintable() and not set(self.model) - {"id", "sha256"}
        if not named or (self._sha256 is not None and not re.fullmatch("[0-9a-f]{64}", self._sha256)):
            must_be = "a mapping with a printable id and a sha256 of 64 digits 0-9 a-f"
            raise ParameterError("Mqtt", "model", dict(self.model), must_be)
        if not 0 <= (self.threshold or 0) <= 1:
            raise ParameterError("Mqtt", "threshold", self.threshold, "from 0 to 1")
        if self.consecutive is not None and self.consecutive < 1:
            raise ParameterError("Mqtt", "consecutive", self.consecutive, "at least 1")

    @property
    def place(self) -> str:
        """Broker and topic."""
        return f"{self._broker}/{self._topic}"

    async def open(self, run: Run) -> None:
        """Connect, and say that we are online.

        Raises:
            EndpointError: if the broker is unreachable or refuses us.
        """
        self._run, self._seq = run, 0
        self._faults: dict[str, set[Fault]] = {}  # by finger
        self._health = HealthReports(run)
        self._clock: dict[str, Json] | None = None  # how a device's clock stood last
        self._batch: Batch | None = None  # that is being written
        self._left = deque[Message]()  # of it, to be published
        identifier = f"slipflow/{self.site}/{self.rig}"  # the same in each run: a new one disarms an old will
        self._publisher = Publisher(self._broker, self._topic, identifier, self._status("offline", None))
        online = self._status("online", run.clock.now())
        try:
            await self._publisher.send(deque([online, self._info(), self._head(), self._report()]))
        except BaseException:
            await self._publisher.close()
            raise
        self._reporting = asyncio.create_task(self._keep_reporting())

    async def write(self, batch: Slips | Faults | Clocks) -> None:
        """Publish the events of a batch; called again with the same batch, go on where it failed.

        Raises:
            EndpointError: if the broker is lost or refuses.
        """
        if isinstance(batch, Faults):
            known = self._faults.setdefault(finger_name(batch.finger), set())
            for _, fault, begins in faults(batch):
                (known.add if begins else known.discard)(fault)
            return
        if isinstance(batch, Clocks):
            self._clock = clock_report(batch)
            return
        if batch is not self._batch:
            self._batch, self._left = batch, deque(self._messages(batch))
        await self._publisher.send(self._left)

    async def close(self) -> None:
        """Say that we are offline, and leave."""
        self._reporting.cancel()
        await asyncio.wait([self._reporting])
        await self._publisher.close(self._status("offline", self._run.clock.now()))

    def _degraded(self, finger: str) -> tuple[Fault, ...]:
        return tuple(sorted(self._faults.get(finger, ()), key=lambda fault: (fault.barometer, fault.kind)))

    def _messages(self, batch: Slips) -> Iterator[Message]:
        finger = finger_name(batch.finger)
        rows = zip(batch.time.tolist(), batch.state.tolist(), batch.probability.tolist(), strict=True)
        for time, state, probability in rows:
            self._seq += 1
            event = Event(
                self.site,
                self.rig,
                finger,
                self._run.session,
                self._seq,
                onset=state == SLIP,
                time=time,
                probability=probability,
                latency=(self._run.clock.now() - time) / ms,
                threshold=self.threshold,
                consecutive=self.consecutive,
                model=self._model,
                sha256=self._sha256,
                degraded=self._degraded(finger),
            )
            yield Message(f"{finger}/event", event.encode(), retain=False)
            yield _message(
                f"{finger}/state",
                {"slip": event.onset, "p": probability, "since": timestamp(time), "seq": event.seq},
            )
            yield self._head()

    def _status(self, state: str, since: int | None) -> Message:
        return _message(
            "status",
            {
                "state": state,
                "epoch": self._run.session,
                "version": version("slipflow"),
                "since": None if since is None else timestamp(since),  # a will cannot know
            },
        )

    def _info(self) -> Message:
        return _message(
            "info",
            {
                "flow": self._run.flow,
                "epoch": self._run.session,
                "sources": {name: dict(description) for name, description in self._run.describe.items()},
                "model": {"id": self._model, "sha256": self._sha256},
                "threshold": self.threshold,
                "consecutive": self.consecutive,
                "units": {"p": "1", "sample_time_ns": "ns", "latency_ms": "ms"},
            },
        )

    def _head(self) -> Message:
        return _message("head", {"epoch": self._run.session, "last_seq": self._seq})

    def _report(self) -> Message:
        degraded: dict[str, Json] = {
            finger: [asdict(fault) for fault in self._degraded(finger)] for finger in self._faults
        }
        return _message("health", {**self._health.next(), "degraded": degraded, "clock": self._clock})

    async def _keep_reporting(self) -> None:
        """Publish the health for ever; it is this, too, that connects again while there is no event."""
        failed = False
        while True:
            await asyncio.sleep(HEALTH_EVERY)
            try:
                await self._publisher.send(deque([self._report()]))
            except SlipflowError as error:
                if not failed:
                    log.warning("%s, trying again", error)
                failed = True
            else:
                failed = False


def _message(topic: str, document: dict[str, Json]) -> Message:
    return Message(topic, encode(document))
