"""A rig in a process of its own: a live flow that publishes an event for every touch sample.

    python -m tests.chaos.publish URL OUTBOX [--rate HZ] [--record FOLDER] [--score]

Prints a line ``event TIME`` for each event once it may not be lost any more, and ``status JSON`` twice a
second and at the end: how sources and sinks do. Runs until SIGTERM.
"""

import argparse
import asyncio
import json
import os
import time
from dataclasses import asdict

from connectors import Mqtt
from flows.graph import Flow
from flows.run.clocks import LoopClock
from flows.run.live_runner import LiveRunner
from operators import Align, Clocks, Faults, Label, Run, Scores, Sink, Slips, Zero, ms
from tests.chaos.devices import Arm, Fingertip, Turning

SITE, RIG = "chaos", "rig"
STATUS_EVERY = 0.5  # s


class Telling(Mqtt):
    """Says which events may not be lost any more."""

    async def write(self, batch: Slips | Faults | Clocks) -> None:
        """Publish, and say so."""
        await super().write(batch)
        if isinstance(batch, Slips):
            for each in batch.time.tolist():
                say(f"event {each}")


class Discard(Sink[Scores]):
    """Drops the scores: only the load of the detector counts."""

    @property
    def destination(self) -> str:
        """Nowhere."""
        return "nowhere"

    async def open(self, run: Run) -> None:
        """Open nothing."""

    def take(self, batch: Scores) -> bool:
        """Drop the batch."""
        return True

    async def close(self) -> None:
        """Close nothing."""


def say(line: str) -> None:
    """Print a line, which no kill can take back."""
    os.write(1, f"{line}\n".encode())


def declared(options: argparse.Namespace) -> Flow:
    """The flow that the options ask for."""
    flow = Flow("chaos")
    touch = flow.source(Fingertip(options.rate), "touch")
    zeroed = touch | Zero(515)
    slips = zeroed | Turning()
    if options.score:
        from operators import Score  # noqa: PLC0415 - a kill should not have to wait for what is not used
        from storage import load_detector  # noqa: PLC0415 - as above

        (zeroed | Score(load_detector("tcn"))).to(Discard())
    if options.record:
        from storage import Dataset  # noqa: PLC0415 - as above

        dataset, motion = Dataset(options.record), flow.source(Arm(1.25 * options.rate), "motion")
        touch.to(dataset)
        motion.to(dataset)
        (zeroed & motion | Align(within=20 * ms) | Label(speed=0.003)).to(dataset)
        slips.to(dataset)
    slips.to(Telling(options.url, SITE, RIG, outbox=options.outbox))
    return flow


def tell(run: Run) -> None:
    """Say how sources and sinks do."""
    sinks = {name: asdict(sink) for name, sink in run.sinks.items()}
    rows = {name: source.rows for name, source in run.sources.items()}
    offset = run.clock.host_offset if isinstance(run.clock, LoopClock) else None
    say(f"status {json.dumps({'sources': rows, 'sinks': sinks, 'host_offset': offset})}")


async def keep_telling(run: Run) -> None:
    """Tell again and again."""
    while True:
        tell(run)
        await asyncio.sleep(STATUS_EVERY)


async def main() -> None:
    """Run the flow."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("url")
    parser.add_argument("outbox")
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--record")
    parser.add_argument("--score", action="store_true")
    options = parser.parse_args()
    runner = LiveRunner(declared(options), f"chaos-{time.time_ns()}")
    telling = asyncio.create_task(keep_telling(runner.run))
    await runner.execute()
    telling.cancel()
    tell(runner.run)


if __name__ == "__main__":
    asyncio.run(main())
