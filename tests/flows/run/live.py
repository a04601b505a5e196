"""Live runs of scores that come every 10 ms, in virtual time."""

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any

from flows.graph import Flow
from flows.graph.testing import TestSink, VirtualLoop, run_virtually
from flows.run.clocks import LoopClock
from flows.run.live_runner import LiveRunner
from operators import Clock, Run, Scores, Sink, Source, ms, s


def scores(first: int, count: int, probability: float = 0.9) -> list[Scores]:
    """One-row batches, 10 ms apart, from the `first`-th on."""
    return [Scores.rows([k * 10 * ms], probability) for k in range(first, first + count)]


def flow_of(source: Source[Any], *sinks: Sink[Any]) -> Flow:
    """A flow from one source to sinks."""
    flow = Flow("f")
    stream = flow.source(source)
    for sink in sinks:
        stream.to(sink)
    return flow


def execute(
    flow: Flow,
    *,
    duration: int | None = None,
    start: int = s,
    stops: tuple[float, ...] = (),
    at: Mapping[float, Callable[[LiveRunner, VirtualLoop], object]] | None = None,
) -> Run:
    """A whole run in virtual time, from `start` (ns), stopped at some times (s), with calls `at` others."""

    async def main() -> Run:
        runner = LiveRunner(flow, "test", clock=LoopClock(start), duration=duration)
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        for time in stops:
            loop.call_later(time, runner.stop)
        for time, call in (at or {}).items():
            loop.call_later(time, call, runner, loop)
        return await runner.execute()

    return run_virtually(main())


def times(sink: TestSink) -> list[int]:
    """Which scores a sink was given."""
    return [time // (10 * ms) for time in sink.rows(Scores).time.tolist()]


class Endless(Source[Scores]):
    """A score every 10 ms, for ever."""

    recorded: str | None = None

    def __init__(self) -> None:
        self.closed = False

    @property
    def kind(self) -> type[Scores]:
        return Scores

    @property
    def recording(self) -> str | None:
        return self.recorded

    async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
        try:
            while True:
                await clock.sleep_until(clock.now() + 10 * ms)
                yield Scores.rows([clock.now()], 0.9)
        finally:
            self.closed = True
