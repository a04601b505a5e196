"""A live flow that a fingertip floods with rows, in a process of its own.

    python -m tests.chaos.flooded FOLDER RATE FLOOD AFTER

RATE rows a second for FLOOD seconds, each a batch of its own, then 100 a second for AFTER seconds. What
the device cannot hand over it buffers for up to a second, as drivers do; what is older is lost in it, and
counted. Prints a JSON object.
"""

import asyncio
import json
import os
import sys
from collections.abc import AsyncIterator
from dataclasses import asdict
from pathlib import Path

import numpy as np

from flows.graph import Flow
from flows.run.live_runner import LiveRunner
from operators import Clock, Debounce, Score, Source, Touch, Zero, s
from storage import Dataset, load_detector
from tests.chaos.child import memory
from tests.chaos.numbered import touch

USUAL = 100.0  # rows/s
BUFFER = s  # ns, of the device
SESSION = "flooded"
LOOK = 0.05  # s


class Flooding(Source[Touch]):
    """Gives many rows a second for a while, then as many as usual."""

    def __init__(self, rate: float, flood: float) -> None:
        self._rate, self._flood = rate, flood
        self.given = self.overrun = 0
        self.began = asyncio.Event()
        self.ended = 0  # ns, when the flood was over

    @property
    def kind(self) -> type[Touch]:
        """Touch."""
        return Touch

    @property
    def fingers(self) -> tuple[int, ...]:
        """One fingertip."""
        return (0,)

    async def batches(self, clock: Clock) -> AsyncIterator[Touch]:
        """For ever."""
        origin = clock.now()
        count = round(self._rate * self._flood)
        self.ended = origin + round(self._flood * s)
        self.began.set()
        number = 0
        while True:
            if number < count:
                due = origin + round(number * s / self._rate)
            else:
                due = self.ended + round((number - count) * s / USUAL)
            await clock.sleep_until(due)
            if clock.now() - due > BUFFER:
                self.overrun += 1
            else:
                yield touch(np.array([self.given]), np.array([due]))
                self.given += 1
            number += 1


async def main(folder: Path, rate: float, flood: float, after: float) -> object:
    """Run; say what happened."""
    source, flow = Flooding(rate, flood), Flow("flooded")
    felt = flow.source(source, "touch")
    slips = (
        felt | Zero(500) | Score(load_detector("tcn")) | Debounce(threshold=0.5, consecutive=2, release=10)
    )
    dataset = Dataset(folder)
    felt.to(dataset)
    slips.to(dataset)
    runner = LiveRunner(flow, SESSION)
    running = asyncio.create_task(runner.execute())
    sizes, lags, status = list[float](), list[tuple[float, float]](), runner.run.sources["touch"]
    await source.began.wait()
    start = memory(os.getpid())
    while (now := runner.clock.now()) < source.ended + round(after * s):
        sizes.append(memory(os.getpid()))
        lags.append(((now - source.ended) / s, (now - status.newest) / s))
        await asyncio.sleep(LOOK)
    runner.stop()
    run = await running
    return {
        "given": source.given,
        "overrun": source.overrun,
        "start": start,
        "most": max(sizes),
        "end": sizes[-1],
        "lags": lags,
        "sink": {name: asdict(sink) for name, sink in run.sinks.items()},
    }


if __name__ == "__main__":
    place, *numbers = sys.argv[1:]
    told = asyncio.run(main(Path(place), *map(float, numbers)))
    os.write(1, json.dumps(told).encode())
