"""Live runs of scores that come every 10 ms, in virtual time."""

from collections.abc import AsyncIterator

import numpy as np

from flows.graph import Flow
from flows.graph.testing import TestSink, run_virtually
from flows.run.live_runner import LiveRunner
from operators import Clock, Run, Scores, Source, ms


def scores(first: int, count: int, probability: float = 0.9) -> list[Scores]:
    """One-row batches, 10 ms apart, from the `first`-th on."""
    rows = range(first, first + count)
    return [Scores(np.array([k * 10 * ms]), np.array([probability])) for k in rows]


def execute(flow: Flow, *, duration: int | None = None) -> Run:
    """A whole run, in virtual time."""

    async def main() -> Run:
        return await LiveRunner(flow, "test", duration=duration).execute()

    return run_virtually(main())


def times(sink: TestSink) -> list[int]:
    """Which scores a sink was given."""
    return [time // (10 * ms) for time in sink.rows(Scores).time.tolist()]


class Endless(Source[Scores]):
    """A score every 10 ms, for ever."""

    def __init__(self) -> None:
        self.closed = False

    @property
    def kind(self) -> type[Scores]:
        return Scores

    async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
        try:
            while True:
                await clock.sleep_until(clock.now() + 10 * ms)
                yield Scores(np.array([clock.now()]), np.array([0.9]))
        finally:
            self.closed = True
