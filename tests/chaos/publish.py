"""Live flow that publishes an event for each touch sample, as a process.

    python -m tests.chaos.publish URL OUTBOX

Prints a line ``event TIME`` for each event that must not be lost from then on. Runs until SIGTERM.
"""

import asyncio
import os
import sys
import time
from dataclasses import dataclass, field

import numpy as np

from connectors import Mqtt
from flows.graph import Flow
from flows.run.live_runner import LiveRunner
from flows.run.supervision import signals_to
from operators import SLIP, STATIC, Clocks, Faults, Operator, Slips, Touch, Zero, Zeroed
from tests.chaos.numbered import Numbered, touch

SITE, RIG = "chaos", "rig"
RATE = 100.0  # events/s


@dataclass
class Alternating(Operator[Zeroed, Slips]):
    """Slip event at each row, alternately onset and end."""

    _state: int = field(default=STATIC, init=False)

    def process(self, batch: Zeroed) -> Slips:
        """Return one event for each row."""
        states = (self._state + 1 + np.arange(len(batch))) % (SLIP + 1)
        self._state = int(states[-1])
        probability = np.full(len(batch), 0.9)
        return Slips(batch.time, states.astype(np.int8), batch.time, probability, finger=batch.finger)


class ReportingMqtt(Mqtt):
    """Event sink that prints the events that it has accepted, by a write that survives a kill."""

    async def write(self, batch: Slips | Faults | Clocks) -> None:
        """Publish a batch and print its events."""
        await super().write(batch)
        if isinstance(batch, Slips):
            for each in batch.time.tolist():
                os.write(1, f"event {each}\n".encode())


async def main(url: str, outbox: str) -> None:
    """Run the flow."""
    flow = Flow("chaos")
    zeroed = flow.source(Numbered(Touch, touch, RATE), "touch") | Zero(515)
    (zeroed | Alternating()).to(ReportingMqtt(url, SITE, RIG, outbox=outbox))
    runner = LiveRunner(flow, f"chaos-{time.time_ns()}")
    with signals_to(runner.stop):
        await runner.execute()


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
