"""Live flow that publishes an event for each touch sample, as a process.

    python -m tests.chaos.publish URL OUTBOX [--rate HZ] [--record FOLDER] [--score]

Prints a line ``event TIME`` for each event that must not be lost from then on, and a line ``status JSON``
with the state of sources and sinks twice per second and at the end. Runs until SIGTERM.
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
from tests.chaos.devices import Alternating, Arm, Fingertip

SITE, RIG = "chaos", "rig"
STATUS_EVERY = 0.5  # s


class ReportingMqtt(Mqtt):
    """Event sink that prints the events that it has accepted."""

    async def write(self, batch: Slips | Faults | Clocks) -> None:
        """Publish a batch and print its events."""
        await super().write(batch)
        if isinstance(batch, Slips):
            for each in batch.time.tolist():
                print_line(f"event {each}")


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


def print_line(line: str) -> None:
    """Print a line, which survives a kill."""
    os.write(1, f"{line}\n".encode())


def declare(options: argparse.Namespace) -> Flow:
    """Declare the flow for the options."""
    flow = Flow("chaos")
    touch = flow.source(Fingertip(options.rate), "touch")
    zeroed = touch | Zero(515)
    slips = zeroed | Alternating()
    if options.score:
        from operators import Score  # noqa: PLC0415 - delays the start
        from storage import load_detector  # noqa: PLC0415 - as above

        (zeroed | Score(load_detector("tcn"))).to(Discard())
    if options.record:
        from storage import Dataset  # noqa: PLC0415 - as above

        dataset, motion = Dataset(options.record), flow.source(Arm(1.25 * options.rate), "motion")
        touch.to(dataset)
        motion.to(dataset)
        (zeroed & motion | Align(within=20 * ms) | Label(speed=0.003)).to(dataset)
        slips.to(dataset)
    slips.to(ReportingMqtt(options.url, SITE, RIG, outbox=options.outbox))
    return flow


def print_status(run: Run) -> None:
    """Print the state of sources and sinks."""
    sinks = {name: asdict(sink) for name, sink in run.sinks.items()}
    rows = {name: source.rows for name, source in run.sources.items()}
    offset = run.clock.host_offset if isinstance(run.clock, LoopClock) else None
    print_line(f"status {json.dumps({'sources': rows, 'sinks': sinks, 'host_offset': offset})}")


async def print_status_regularly(run: Run) -> None:
    """Print the state until cancelled."""
    while True:
        print_status(run)
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
    runner = LiveRunner(declare(options), f"chaos-{time.time_ns()}")
    printing = asyncio.create_task(print_status_regularly(runner.run))
    await runner.execute()
    printing.cancel()
    print_status(runner.run)


if __name__ == "__main__":
    asyncio.run(main())
