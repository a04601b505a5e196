"""Whatever is killed, every event arrives."""

import random
import subprocess
import sys
from pathlib import Path
from queue import Queue
from threading import Thread

import pytest

from connectors.testing import PATIENCE, TestBroker

pytestmark = pytest.mark.broker

PUBLISH = """
import asyncio, sys, time
import numpy as np
from connectors import Mqtt
from operators.batch import Slips
from operators.ports import Run

class Clock:
    now = time.time_ns

async def main(url, outbox, first):
    sink = Mqtt(url, outbox=outbox)
    await sink.open(Run("chaos", "chaos", Clock, 0))
    for number in range(int(first), 10**9):  # the number is the event's time
        one = np.array([number])
        await sink.write(Slips(one, np.array([number % 2], np.int8), one, np.array([0.9]), finger=0))
        print(number, flush=True)  # from here on it may not be lost
        await asyncio.sleep(0.002)

asyncio.run(main(*sys.argv[1:]))
"""
CONSUME = """
import asyncio, sys
from connectors import Consumer

async def main(url, position):
    async with Consumer(url, since="start", remember=position) as events:
        async for event in events:
            print(event.time, event.identifier, flush=True)

asyncio.run(main(*sys.argv[1:]))
"""


class Process:
    """A process whose lines are read as they come, over all its lives."""

    def __init__(self, code: str, *arguments: str) -> None:
        self._command = [sys.executable, "-c", code, *arguments]
        self.lines = Queue[str]()
        self.seen = list[str]()

    def start(self, *more: str) -> None:
        self._process = subprocess.Popen([*self._command, *more], stdout=subprocess.PIPE, text=True)
        self._reader = Thread(target=self._read)
        self._reader.start()

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        self._reader.join()

    def wait(self, count: int) -> None:
        """Read so many more lines."""
        self.seen += [self.lines.get(timeout=PATIENCE) for _ in range(count)]

    def rest(self) -> None:
        """Read what there is."""
        while not self.lines.empty():
            self.seen.append(self.lines.get())

    def _read(self) -> None:
        assert self._process.stdout
        with self._process.stdout as lines:
            for line in lines:
                if line.endswith("\n"):  # else the kill cut it
                    self.lines.put(line.strip())


def test_kills_of_publisher_broker_and_consumer_lose_no_event(broker: TestBroker, tmp_path: Path) -> None:
    chance = random.Random(7)  # noqa: S311 - not for secrets
    publisher = Process(PUBLISH, broker.url, str(tmp_path / "outbox.sqlite"))
    consumer = Process(CONSUME, broker.url, str(tmp_path / "position"))
    consumer.start()
    publisher.start("1")
    try:
        publisher.wait(20)
        consumer.wait(1)
        for victim in chance.sample(["publisher", "broker", "consumer"] * 3, 9):
            publisher.wait(chance.randrange(5, 60))
            if victim == "broker":
                broker.stop()
                publisher.wait(chance.randrange(1, 30))
                broker.start()
            elif victim == "consumer":
                consumer.kill()
                publisher.wait(chance.randrange(1, 30))
                consumer.start()
            else:
                publisher.kill()
                publisher.rest()
                publisher.start(str(int(publisher.seen[-1]) + 2))  # one may be kept that was not printed
        publisher.wait(1)
        publisher.kill()
        publisher.rest()
        written = {int(line) for line in publisher.seen}
        last = max(written) + 2
        publisher.start(str(last))  # it sends what waits, and answers
        missing = written - {int(line.split()[0]) for line in consumer.seen}
        while missing:
            consumer.wait(1)
            missing.discard(int(consumer.seen[-1].split()[0]))
    finally:
        publisher.kill()
        consumer.kill()
    assert len(written) > 200
    by_identifier = dict[str, str]()
    for line in consumer.seen:
        time, identifier = line.split()
        assert by_identifier.setdefault(identifier, time) == time  # no number twice
    copies = len(consumer.seen) - len(set(consumer.seen))
    assert copies <= 3 * 50  # only around the kills of the consumer
