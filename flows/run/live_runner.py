"""Live execution of a flow: one task per source, operators called inline, one queue per sink."""

import asyncio
from collections import defaultdict
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import aclosing, nullcontext
from typing import Any

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Delivery, Entry
from flows.graph.drawing import streams
from flows.graph.node import Node
from flows.run import log_events
from flows.run.clocks import STEP, LoopClock
from flows.run.replay_runner import replayed_recording
from flows.run.sink_queue import SinkQueue
from flows.run.stop_signals import signals_to
from operators.back_off import BackOff
from operators.batch import Batch, ms
from operators.operator import LateRowFilter
from operators.ports import Clock, ClockStep, Gap, Run, Sink, Source, SourceStatus

CLOCK_CHECK = 1.0  # s, between two checks of the host's clock
YIELD_EVERY = 16  # rows; a source that never waits yields to the event loop after as many
LAGGING = 50 * ms  # ns; a source whose newest row is older is catching up, as after a stall of the host
PASSES = 8  # passes of the event loop that a source catching up waits for older rows of the others


class LiveRunner:
    """One live run of a flow.

    A source that fails is restarted with a back-off, and its gap is recorded. A sink that fails is retried
    with the same batch and never blocks the others. While a lossless sink is slow, the sources wait; other
    sinks drop their oldest batch. A sink that is stuck counts as failing. Rows for which a failing sink has
    no room are counted as dropped. Steps of the host's clock are recorded; they do not affect time stamps.

    Args:
        flow: Flow to run.
        session: Identifier of the run.
        clock: Clock of the run; default: `LoopClock`.
        duration: End of the run after this time, ns; default: when all sources end.
        signals: Stop on SIGINT and SIGTERM. A stopped replay is marked as incomplete.

    Raises:
        FlowError: if the flow is wired wrongly.
    """

    def __init__(
        self,
        flow: Flow,
        session: str,
        *,
        clock: Clock | None = None,
        duration: int | None = None,
        signals: bool = True,
    ) -> None:
        self.compiled = CompiledFlow(flow)
        self.clock = clock or LoopClock()
        self._duration, self._signals = duration, signals
        self._sources: dict[Node, Source[Any]] = {
            node: node.part for node in flow.nodes if isinstance(node.part, Source)
        }
        self.run = Run(
            session,
            flow.name,
            self.clock,
            self.clock.now(),
            recording=replayed_recording(self._sources.values()),
            declaration=tuple(streams(flow.nodes)),
            sink_types=self.compiled.sink_types,
        )
        for node, source in self._sources.items():
            self.run.describe[node.name] = source.describe()
            self.run.sources[node.name] = SourceStatus()
        self._queues = {
            node: SinkQueue(node.name, node.part) for node in flow.nodes if isinstance(node.part, Sink)
        }
        for queue in self._queues.values():
            self.run.sinks[queue.name] = queue.status
        self._push = asyncio.Lock()  # while a sink is full, all sources wait: streams stay in order
        self._pending = 0  # batches of sources that wait for room in a queue
        self._delivered, self._ending = asyncio.Event(), False
        self._stop, self._stops = asyncio.Event(), 0
        self._writers: list[asyncio.Task[None]] = []

    def stop(self) -> None:
        """End the run: flush the operators, write the queues, close the sinks.

        The second call abandons failing sinks, the third one all writes in progress.
        """
        self._stops += 1
        self._stop.set()
        if self.run.recording is not None:
            self.run.error = "was interrupted"
        if self._stops > 1:
            for queue in self._queues.values():
                queue.abandon()
        if self._stops > 2:  # noqa: PLR2004 - see above
            for writer in self._writers:
                writer.cancel()

    async def execute(self) -> Run:
        """Run until all sources end, the duration is over, or `stop` is called.

        Raises:
            SlipflowError: if a sink cannot be opened or an operator fails; earlier output is committed.
        """
        opened: list[SinkQueue] = []
        for source in self._sources.values():
            await source.prepare()
        self.run.start = self.clock.now()
        try:
            for queue in self._queues.values():
                await queue.sink.open(self.run)
                opened.append(queue)
        except BaseException as error:
            self.run.error = str(error) or type(error).__name__
            for queue in opened:
                await queue.sink.close()
            raise
        with signals_to(self.stop) if self._signals else nullcontext():
            await self._run_tasks()
        return self.run

    async def _run_tasks(self) -> None:
        self._writers = [asyncio.create_task(queue.run()) for queue in self._queues.values()]
        readers = [asyncio.create_task(self._read(node)) for node in self._sources]
        ends: list[asyncio.Task[Any]] = [asyncio.create_task(self._stop.wait())]
        watching = asyncio.create_task(self._watch_host_clock())
        if self._duration is not None:
            ends.append(asyncio.create_task(self.clock.sleep_until(self.clock.now() + self._duration)))
        reading = asyncio.gather(*readers)
        try:
            await asyncio.wait([reading, *ends], return_when=asyncio.FIRST_COMPLETED)
            self._ending = True
            while self._pending and not reading.done():  # deliver pending batches
                self._delivered.clear()
                await self._delivered.wait()
            for task in readers:
                task.cancel()
            await asyncio.wait(readers)
            for task in readers:
                if not task.cancelled():
                    task.result()  # raises an operator's error, which ends the run
            await self._deliver(self.compiled.flush())
        except Exception as error:
            self.run.error = log_events.reason_of(error)
            raise
        finally:
            tasks: list[asyncio.Task[Any]] = [*readers, *ends, watching]
            for task in tasks:
                task.cancel()
            await asyncio.gather(reading, *tasks, return_exceptions=True)
            for queue in self._queues.values():
                queue.complete()
            await asyncio.gather(*self._writers, return_exceptions=True)

    async def _read(self, node: Node) -> None:
        status, filters = self.run.sources[node.name], defaultdict[int, LateRowFilter](LateRowFilter)
        async with aclosing(self._batches(node, status)) as batches:
            async for batch in batches:
                in_time = filters[batch.finger]
                late = in_time.late
                in_time.filter(batch)
                status.late += in_time.late - late
                status.newest = max(status.newest, in_time.newest)
                status.rows += len(batch)
                await self._process({(node, batch.finger): batch})
                if self._ending:
                    return
                if self.clock.now() - status.newest > LAGGING:
                    await self._wait_for_older_rows(status)
                if status.rows % YIELD_EVERY < len(batch):
                    await asyncio.sleep(0)  # let the sinks run

    async def _process(self, batches: Mapping[Entry, Batch]) -> None:
        """Push batches through the operators into the queues; wait while a queue is full."""
        waiting = None if self._pending else self._enqueue(self.compiled.push(batches))
        if waiting == []:
            return  # the usual case: no await, so no other source ran in between
        self._pending += 1
        try:
            async with self._push:
                await self._deliver(self.compiled.push(batches) if waiting is None else waiting)
        finally:
            self._pending -= 1
            self._delivered.set()

    def _enqueue(self, deliveries: list[Delivery]) -> list[Delivery]:
        """Queue deliveries up to the first full queue; return the rest."""
        for index, (node, batch) in enumerate(deliveries):
            if not self._queues[node].try_put(batch):
                return deliveries[index:]
        return []

    async def _wait_for_older_rows(self, status: SourceStatus) -> None:
        """Let other sources deliver older rows first: a join waits only for a limited time."""
        others = [other for other in self.run.sources.values() if other is not status]
        for _ in range(PASSES):
            if not any(other.up and 0 < other.newest < status.newest for other in others):
                return
            await asyncio.sleep(0)

    async def _batches(self, node: Node, status: SourceStatus) -> AsyncGenerator[Batch]:
        """Yield the batches of a source, restarting it after failures."""
        retry, failed_at, reason = BackOff(), 0, ""
        try:
            while True:
                stream = self._sources[node].batches(self.clock)
                try:
                    async for batch in stream:
                        if not len(batch.check()):
                            continue
                        if failed_at:
                            status.gaps.append(gap := Gap(failed_at, self.clock.now(), reason))
                            log_events.source_restarted(node.name, gap)
                            failed_at = 0
                            retry.reset()
                        status.up, status.error = True, ""
                        yield batch
                except Exception as error:  # noqa: BLE001 - retry after any error
                    if not failed_at:
                        failed_at, reason = status.newest or self.run.start, log_events.reason_of(error)
                        log_events.source_failed(node.name, reason)
                    status.up, status.error = False, log_events.reason_of(error)
                    status.failures += 1
                else:
                    return
                finally:
                    if isinstance(stream, AsyncGenerator):  # release the device before it is opened again
                        await stream.aclose()
                await asyncio.sleep(retry.delay())
        finally:
            status.up = False
            if failed_at:  # it did not recover
                status.gaps.append(Gap(failed_at, self.clock.now(), reason))

    async def _deliver(self, deliveries: Sequence[Delivery]) -> None:
        for node, batch in deliveries:
            await self._queues[node].put(batch)

    async def _watch_host_clock(self) -> None:
        """Record steps of the host's clock."""
        while (offset := self.clock.host_offset if isinstance(self.clock, LoopClock) else None) is not None:
            known = self.run.clock_steps[-1].offset if self.run.clock_steps else 0
            if abs(offset - known) >= STEP:
                self.run.clock_steps.append(ClockStep(self.clock.now(), offset))
                log_events.clock_set(offset, known)
            await asyncio.sleep(CLOCK_CHECK)
