"""Live runs of scores that come every 10 ms, in virtual time."""

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping, Sequence
from typing import Any

from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource, VirtualLoop, run_virtually
from flows.run.clocks import LoopClock
from flows.run.live_runner import LiveRunner
from operators import EVERY, Batch, Clock, Fingertip, Operator, Run, Scores, Sink, Source, Touch, ms, s


def scores(first: int, count: int, probability: float = 0.9) -> list[Scores]:
    """One-row batches, 10 ms apart, from the `first`-th on."""
    return [Scores.rows([k * 10 * ms], probability) for k in range(first, first + count)]


def flow_of(source: Source[Any], *sinks: Sink[Any], through: Sequence[Operator[Any, Any]] = ()) -> Flow:
    """A flow from one source, through operators, to sinks."""
    flow = Flow("f")
    stream = flow.source(source)
    for operator in through:
        stream = stream | operator
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


class FaultySink(TestSink):
    """Sink that raises an exception in its first writes (None: it writes), and awaits a call before each."""

    def __init__(
        self,
        destination: str = "",
        *,
        lossless: bool = True,
        capacity: int = 4096,
        failures: Sequence[Exception | None] = (),
        before_write: Callable[[], Coroutine[Any, Any, None]] | None = None,
    ) -> None:
        super().__init__(destination)
        self.lossless, self.capacity = lossless, capacity
        self._failures, self._before_write = list(failures), before_write

    def take(self, batch: Batch) -> bool:
        return not self._before_write and self._keep(batch)

    async def write(self, batch: Batch) -> None:
        if self._before_write:
            await self._before_write()
        self._keep(batch)

    def _keep(self, batch: Batch) -> bool:
        if self._failures and (failure := self._failures.pop(0)):
            raise failure
        return super().take(batch)


class Described(TestSource[Touch]):
    """Source of touch of a described fingertip."""

    def __init__(self, fingertip: Fingertip, fingers: tuple[int, ...] = (EVERY,)) -> None:
        super().__init__(Touch, fingers=fingers)
        self._fingertip = fingertip

    @property
    def fingertip(self) -> Fingertip:
        return self._fingertip


class Endless(Source[Scores]):
    """A score every 10 ms, for ever."""

    recorded: str | None = None

    @property
    def kind(self) -> type[Scores]:
        return Scores

    @property
    def recording(self) -> str | None:
        return self.recorded

    async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
        while True:
            await clock.sleep_until(clock.now() + 10 * ms)
            yield Scores.rows([clock.now()], 0.9)
