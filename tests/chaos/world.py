"""A rig, a broker and a consumer that go on by themselves."""

import json
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.chaos.child import Child, memory, until
from tests.chaos.follow import Had, read
from tests.chaos.proxy import Line
from tests.connectors.mqtt.broker_process import TestBroker


@dataclass(frozen=True)
class Outcome:
    """What came of the events of a rig."""

    made: int
    had: list[Had]  # by the consumer, in the order in which they came
    lost: int
    copies: int  # that the consumer's list has besides
    twice: int  # numbers that stand for more than one event
    status: Any  # of the run's sources and sinks at its end


@dataclass(frozen=True)
class World:
    """The three, and the line from the rig to the broker."""

    folder: Path
    broker: TestBroker
    line: Line
    rig: Child
    consumer: Child

    def made(self) -> list[int]:
        """The times (ns) of the events that may not be lost."""
        return [int(word) for word in self.rig.said("event")]

    def status(self) -> Any:  # noqa: ANN401 - JSON
        """How the rig's sources and sinks do, as it said last."""
        return json.loads(self.rig.said("status")[-1])

    def had(self) -> list[Had]:
        """What the consumer kept."""
        return read(self.folder / "list")

    def missing(self) -> set[int]:
        """The times (ns) of the events that the consumer does not have."""
        return set(self.made()) - self._times()

    def wait_for_more(self) -> None:
        """Wait until the rig has made one more event."""
        made = len(self.made())
        self.rig.wait_for(lambda: len(self.made()) > made)

    def finish(self) -> "Outcome":
        """End the run and begin another, which sends what is left and answers; wait until all of it came."""
        self.rig.end()
        made, status, count = set(self.made()), self.status(), -1
        self.rig.start()
        while (now := len(self.had())) > count and not until(lambda: made <= self._times(), pause=0.2):
            count = now
        had = self.had()
        by_number = dict[str, set[int]]()
        for each in had:
            by_number.setdefault(each.identifier, set()).add(each.time)
        return Outcome(
            len(made),
            had,
            len(made - self._times()),
            len(had) - len(by_number),
            sum(len(times) > 1 for times in by_number.values()),
            status,
        )

    def _times(self) -> set[int]:
        return {each.time for each in self.had()}

    def broker_memory(self) -> float:
        """What the broker holds in memory, MB."""
        assert self.broker.process
        return memory(self.broker.process.pid)


@contextmanager
def world(*, rate: float = 100.0, record: bool = False) -> Generator[World]:
    """Start a rig that slips `rate` times a second, and records into ``dataset``."""
    with TemporaryDirectory(prefix="slipflow-chaos-") as name:
        folder = Path(name)
        broker = TestBroker(folder)
        try:
            with Line(broker.port) as line:
                publish = ["-m", "tests.chaos.publish", line.url, str(folder / "outbox"), "--rate", str(rate)]
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
                    rig.wait_for(lambda: bool(rig.said("event")))
                    yield World(folder, broker, line, rig, consumer)
                finally:
                    rig.kill()
                    consumer.kill()
        finally:
            broker.close()
