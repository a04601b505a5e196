"""The rig's flow at many times real time, as a process.

    python -m tests.chaos.soaked FOLDER PACE SECONDS

Records and scores SECONDS of rig time, at most PACE times as fast as real time. Prints a JSON object with the
resident memory (MB) over rig time (s).
"""

import asyncio
import json
import os
import sys
from dataclasses import asdict
from pathlib import Path

from connectors import SimulatedRig
from flows.graph import Flow
from flows.record import declare_recording
from flows.run.live_runner import LiveRunner
from operators import Debounce, Label, Score, ms, s
from storage import Dataset, load_detector
from tests.chaos.child import memory

SESSION = "soaked"
INTERVAL = 0.5  # s
LATENCY = 70 * ms  # ns, of the simulated arm


async def main(folder: Path, pace: float, seconds: float) -> object:
    """Run, and return the figures."""
    flow, dataset, rig = Flow("soaked"), Dataset(folder), SimulatedRig(seed=0, pace=pace)
    zeroed = declare_recording(flow, rig, Label(speed=0.003, delay=LATENCY), dataset)
    (zeroed | Score(load_detector("tcn")) | Debounce(threshold=0.78, consecutive=2, release=12)).to(dataset)
    runner = LiveRunner(flow, SESSION)
    running, touch = asyncio.create_task(runner.execute()), runner.run.sources["touch"]
    sizes, loop = list[tuple[float, float]](), asyncio.get_running_loop()
    began, time = loop.time(), 0.0  # s
    while not running.done() and time < seconds:
        await asyncio.wait([running], timeout=INTERVAL)
        if touch.newest:
            time = (touch.newest - runner.run.start) / s
            sizes.append((time, memory(os.getpid())))
    duration = loop.time() - began
    runner.stop()
    run = await running
    return {
        "memory": sizes,
        "duration": duration,
        "sources": {name: source.rows for name, source in run.sources.items()},
        "late": sum(source.late for source in run.sources.values()),
        "sink": {name: asdict(sink) for name, sink in run.sinks.items()},
    }


if __name__ == "__main__":
    place, *numbers = sys.argv[1:]
    report = asyncio.run(main(Path(place), *map(float, numbers)))
    os.write(1, json.dumps(report).encode())
