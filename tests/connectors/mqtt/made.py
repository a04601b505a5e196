"""Events to test with."""

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import TypeVar

import numpy as np

from connectors import Event, Mqtt
from connectors.mqtt.outbox import Outbox
from operators.batch import Slips, ms
from operators.ports import Run

EVENT = Event(
    site="lab", rig="ur10", finger="0", epoch="ab", seq=1, state="onset", time=1, probability=0.9, latency=1.0
)
FIRST = 99_970 * ms  # 30 ms before the time that the clock of the fixture `run` shows
T = TypeVar("T", Outbox, Mqtt)


def slips(*states: int, finger: int = 0, probability: float = 0.9) -> Slips:
    """Rows 10 ms apart."""
    time = FIRST + 10 * ms * np.arange(len(states))
    return Slips.rows(time, states, time, probability, finger=finger)


@asynccontextmanager
async def opened(sink: T, *run: Run) -> AsyncGenerator[T]:
    """Open and close an outbox, or a sink in a run."""
    await sink.open(*run)
    try:
        yield sink
    finally:
        await sink.close()
