"""System under test: processes of a rig, a broker and a consumer."""

import json
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.chaos.child import Child, memory, until
from tests.chaos.follow import Delivery, read
from tests.chaos.proxy import Proxy
from tests.connectors.mqtt.broker_process import TestBroker


@dataclass(frozen=True)
class Outcome:
    """What happened to the events of a rig."""

    made: int
    delivered: list[Delivery]  # to the consumer, in order of arrival
    lost: int
    duplicates: int  # in the consumer's list
    reused: int  # numbers that stand for more than one event
    status: Any  # of sources and sinks at the end of the run


@dataclass(frozen=True)
class System:
    """Rig, broker, consumer, and the proxy between rig and broker."""

    folder: Path
    broker: TestBroker
    proxy: Proxy
    rig: Child
    consumer: Child

    def made(self) -> list[int]:
        """Return the times (ns) of the events that must not be lost."""
        return [int(word) for word in self.rig.lines_with("event")]

    def status(self) -> Any:  # noqa: ANN401 - JSON
        """Return the newest state of the rig's sources and sinks."""
        return json.loads(self.rig.lines_with("status")[-1])

    def delivered(self) -> list[Delivery]:
        """Return the events that the consumer has stored."""
        return read(self.folder / "list")

    def missing(self) -> set[int]:
        """Return the times (ns) of the events that the consumer does not have."""
        return set(self.made()) - self._times()

    def wait_for_more(self) -> None:
        """Wait for the rig's next event."""
        made = len(self.made())
        self.rig.wait_for(lambda: len(self.made()) > made)

    def finish(self) -> "Outcome":
        """End the run, start another that sends the remaining events, and wait until all have arrived."""
        self.rig.end()
        made, status, count = set(self.made()), self.status(), -1
        self.rig.start()
        while (now := len(self.delivered())) > count and not until(lambda: made <= self._times(), pause=0.2):
            count = now
        delivered = self.delivered()
        by_number = dict[str, set[int]]()
        for each in delivered:
            by_number.setdefault(each.identifier, set()).add(each.time)
        return Outcome(
            len(made),
            delivered,
            len(made - self._times()),
            len(delivered) - len(by_number),
            sum(len(times) > 1 for times in by_number.values()),
            status,
        )

    def _times(self) -> set[int]:
        return {each.time for each in self.delivered()}

    def broker_memory(self) -> float:
        """Return the resident memory of the broker, MB."""
        assert self.broker.process
        return memory(self.broker.process.pid)


@contextmanager
def start_system(*, rate: float = 100.0, record: bool = False) -> Generator[System]:
    """Start a rig with `rate` slip events per second, a broker and a consumer."""
    with TemporaryDirectory(prefix="slipflow-chaos-") as name:
        folder = Path(name)
        broker = TestBroker(folder)
        try:
            with Proxy(broker.port) as proxy:
                publish = [
                    "-m",
                    "tests.chaos.publish",
                    proxy.url,
                    str(folder / "outbox"),
                    "--rate",
                    str(rate),
                ]
                follow = [
                    "-m",
                    "tests.chaos.follow",
                    broker.url,
                    str(folder / "position"),
                    str(folder / "list"),
                ]
                rig = Child(folder, *publish, *(["--record", str(folder / "dataset")] if record else []))
                consumer = Child(folder, *follow)
                try:
                    consumer.start()
                    rig.start()
                    consumer.wait_for(lambda: "ready" in consumer.lines)
                    rig.wait_for(lambda: bool(rig.lines_with("event")))
                    yield System(folder, broker, proxy, rig, consumer)
                finally:
                    rig.kill()
                    consumer.kill()
        finally:
            broker.close()
