"""Live flow whose source floods it with rows, as a process.

    python -m tests.chaos.flooded FOLDER RATE FLOOD AFTER

The source produces RATE rows per second for FLOOD seconds, one per batch, then 100 per second for AFTER
seconds. It buffers rows for up to a second, as drivers do; older rows are lost and counted. Prints a JSON
object.
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
BUFFER = s  # ns, time that the device buffers
SESSION = "flooded"
INTERVAL = 0.05  # s


class Flooding(Source[Touch]):
    """Source with a high rate for `flood` seconds, then the usual one."""

    def __init__(self, rate: float, flood: float) -> None:
        self._rate, self._flood = rate, flood
        self.produced = self.overrun = 0
        self.began = asyncio.Event()
        self.ended = 0  # ns, end of the flood

    @property
    def kind(self) -> type[Touch]:
        """Type of the batches."""
        return Touch

    @property
    def fingers(self) -> tuple[int, ...]:
        """The fingertip."""
        return (0,)

    async def batches(self, clock: Clock) -> AsyncIterator[Touch]:
        """Yield rows without end."""
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
                yield touch(np.array([self.produced]), np.array([due]))
                self.produced += 1
            number += 1


async def main(folder: Path, rate: float, flood: float, after: float) -> object:
    """Run, and return the figures."""
    source, flow = Flooding(rate, flood), Flow("flooded")
    touch_stream = flow.source(source, "touch")
    slips = (
        touch_stream
        | Zero(500)
        | Score(load_detector("tcn"))
        | Debounce(threshold=0.5, consecutive=2, release=10)
    )
    dataset = Dataset(folder)
    touch_stream.to(dataset)
    slips.to(dataset)
    runner = LiveRunner(flow, SESSION)
    running = asyncio.create_task(runner.execute())
    sizes, lags, status = list[float](), list[tuple[float, float]](), runner.run.sources["touch"]
    await source.began.wait()
    start = memory(os.getpid())
    while (now := runner.clock.now()) < source.ended + round(after * s):
        sizes.append(memory(os.getpid()))
        lags.append(((now - source.ended) / s, (now - status.newest) / s))
        await asyncio.sleep(INTERVAL)
    runner.stop()
    run = await running
    return {
        "produced": source.produced,
        "overrun": source.overrun,
        "start": start,
        "most": max(sizes),
        "end": sizes[-1],
        "lags": lags,
        "sink": {name: asdict(sink) for name, sink in run.sinks.items()},
    }


if __name__ == "__main__":
    place, *numbers = sys.argv[1:]
    report = asyncio.run(main(Path(place), *map(float, numbers)))
    os.write(1, json.dumps(report).encode())
