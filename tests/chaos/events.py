"""Kills of rig, broker and consumer: no event is lost."""

import random
import time
from collections import Counter
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from signal import SIGTERM
from typing import NamedTuple

from tests.chaos.processes import Child, scratch, until
from tests.chaos.run import Promise, Scale
from tests.connectors.mqtt.broker_process import TestBroker


class Delivery(NamedTuple):
    """Event that the consumer has stored."""

    time: int  # ns
    identifier: str


@dataclass(frozen=True)
class System:
    """Processes of a rig, a broker and a consumer."""

    folder: Path
    broker: TestBroker
    rig: Child
    consumer: Child

    def made(self) -> set[int]:
        """Return the times (ns) of the events that must not be lost."""
        return {int(word) for word in self.rig.lines_with("event")}

    def delivered(self) -> list[Delivery]:
        """Return the events that the consumer has stored, in order of arrival."""
        path = self.folder / "list"
        *lines, _ = path.read_text().split("\n") if path.exists() else [""]  # the last is empty or incomplete
        rows = map(str.split, lines)
        return [Delivery(int(first), identifier) for first, identifier in rows]

    def finish(self) -> tuple[int, int, int]:
        """End the run, and send the rest in another; return events made, lost, and numbers used twice."""
        self.rig.stop(SIGTERM)
        made, count = self.made(), -1
        self.rig.start()
        while (now := len(self.delivered())) > count and not until(
            lambda: made <= {each.time for each in self.delivered()}, pause=0.2
        ):
            count = now
        by_number = dict[str, set[int]]()
        for each in self.delivered():
            by_number.setdefault(each.identifier, set()).add(each.time)
        lost = made - {each.time for each in self.delivered()}
        return len(made), len(lost), sum(len(times) > 1 for times in by_number.values())


def kills(scale: Scale) -> Sequence[Promise]:
    """Kill rig, broker and consumer at random times."""
    rng = random.Random(scale.seed)  # noqa: S311 - not for secrets
    count, pause = (5, 0.6) if scale.short else (42, 1.35)  # s between two, on average
    victims = (["rig", "broker", "consumer"] * 14)[:count]
    rng.shuffle(victims)
    with _system() as system:
        for victim in victims:
            time.sleep(pause * rng.uniform(0.5, 1.5))
            processes: dict[str, Child | TestBroker] = vars(system)
            process = processes[victim]
            process.stop()
            time.sleep(pause * rng.uniform(0, 0.5))
            process.start()
        most = 50 if scale.short else 3000
        until(lambda: len(system.made()) >= most)
        made, lost, reused = system.finish()
    kinds = ", ".join(f"{victim} {number}" for victim, number in sorted(Counter(victims).items()))
    return [
        Promise(
            f"events: SIGKILL of {kinds}, broker without persistence",
            f"{lost} of {made} events lost, {reused} numbers used twice",
            "0 lost, 0 used twice",
            passed=not lost and not reused and made >= most,
        )
    ]


@contextmanager
def _system() -> Generator[System]:
    """Start a rig, a broker and a consumer."""
    with scratch() as folder:
        broker = TestBroker(folder)
        rig = Child(folder, "publish", broker.url, str(folder / "outbox"))
        consumer = Child(folder, "follow", broker.url, str(folder / "position"), str(folder / "list"))
        try:
            consumer.start()
            rig.start()
            until(lambda: bool(consumer.lines_with("ready") and rig.lines_with("event")))
            yield System(folder, broker, rig, consumer)
        finally:
            rig.stop()
            consumer.stop()
            broker.close()
