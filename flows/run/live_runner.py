"""Running a flow live: a task per source, operators called inline, an queue per sink."""

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
from flows.run.back_off import FIRST_RETRY, LAST_RETRY
from flows.run.clocks import STEP, LoopClock
from flows.run.replay_runner import recorded_of
from flows.run.sink_queue import SinkQueue
from flows.run.stop_signals import signals_to
from operators.batch import Batch, ms
from operators.operator import Order
from operators.ports import Clock, ClockStep, Gap, Run, Sink, Source, SourceStatus

LOOK = 1.0  # s, between two looks at the host's clock
TURN = 16  # rows
BEHIND = 50 * ms  # ns; a source whose newest row is older catches up, as all do after a stall of the host
PASSES = 8  # of the event loop, that a source catching up waits for older rows of another


class LiveRunner:
    """One live run of a flow.

    A source that fails is started again with back-off, and its gap is recorded. A sink that fails is retried
    with the same batch and never stops the others: a lossless one makes the sources wait while it is slow,
    one that is not drops its oldest batch. A sink that is stuck counts as one that fails. Rows that a failed
    sink could not take are counted as dropped. Steps of the host's clock, which change no stamp, are noted.
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
        """Get ready to run `flow` as `session` until its sources end, `duration` (ns) has passed, or `stop`.

        It is a replay if a source gives what was recorded: then a run that was stopped is not complete.
        SIGINT and SIGTERM stop it, unless `signals` are left to whoever runs it.

        Raises:
            FlowError: if the flow is wired wrongly.
        """
        self.plan = CompiledFlow(flow)
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
            recording=recorded_of(self._sources.values()),
            declaration=tuple(streams(flow.nodes)),
            sink_types=self.plan.sink_types,
        )
        for node, source in self._sources.items():
            self.run.describe[node.name] = source.describe()
            self.run.sources[node.name] = SourceStatus()
        self._queues = {
            node: SinkQueue(node.name, node.part) for node in flow.nodes if isinstance(node.part, Sink)
        }
        for queue in self._queues.values():
            self.run.sinks[queue.name] = queue.status
        self._push = asyncio.Lock()  # a full sink makes all sources wait: the rows of a stream stay in order
        self._in_hand = 0  # batches taken from a source that wait for a sink with room
        self._delivered, self._ending = asyncio.Event(), False
        self._stop, self._stops = asyncio.Event(), 0
        self._writers: list[asyncio.Task[None]] = []

    def stop(self) -> None:
        """End the run: operators are flushed, sinks commit.

        Called again, failing sinks are given up; called a third time, all that is still being written is.
        """
        self._stops += 1
        self._stop.set()
        if self.run.recording is not None:
            self.run.error = "was interrupted"
        if self._stops > 1:
            for queue in self._queues.values():
                queue.give_up()
        if self._stops > 2:  # noqa: PLR2004 - as said above
            for writer in self._writers:
                writer.cancel()

    async def execute(self) -> Run:
        """Run to the end.

        Raises:
            SlipflowError: if a sink cannot be opened, or an operator fails; what it gave before is committed.
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
            await self._carry()
        return self.run

    async def _carry(self) -> None:
        self._writers = [asyncio.create_task(queue.carry()) for queue in self._queues.values()]
        readers = [asyncio.create_task(self._read(node)) for node in self._sources]
        ends: list[asyncio.Task[Any]] = [asyncio.create_task(self._stop.wait())]
        watching = asyncio.create_task(self._watch_host())
        if self._duration is not None:
            ends.append(asyncio.create_task(self.clock.sleep_until(self.clock.now() + self._duration)))
        reading = asyncio.gather(*readers)
        try:
            await asyncio.wait([reading, *ends], return_when=asyncio.FIRST_COMPLETED)
            self._ending = True
            while self._in_hand and not reading.done():  # what was taken is delivered
                self._delivered.clear()
                await self._delivered.wait()
            for task in readers:
                task.cancel()
            await asyncio.wait(readers)
            for task in readers:
                if not task.cancelled():
                    task.result()  # raises what an operator raised: that ends the run
            await self._deliver(self.plan.flush())
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
        status, orders = self.run.sources[node.name], defaultdict[int, Order](Order)
        async with aclosing(self._batches(node, status)) as batches:
            async for batch in batches:
                order = orders[batch.finger]
                late = order.late
                order.keep(batch)
                status.late += order.late - late
                status.newest = max(status.newest, order.newest)
                status.rows += len(batch)
                await self._take({(node, batch.finger): batch})
                if self._ending:
                    return
                if self.clock.now() - status.newest > BEHIND:
                    await self._let_older_pass(status)
                if status.rows % TURN < len(batch):
                    await asyncio.sleep(0)  # a source that never waits must let the sinks have their turn

    async def _take(self, batches: Mapping[Entry, Batch]) -> None:
        """Carry what came through the plan; wait if a sink is full, as then does what comes meanwhile."""
        waiting = None if self._in_hand else self._refused(self.plan.push(batches))
        if waiting == []:
            return  # most often: no turn of the event loop went by, and there was nothing to guard
        self._in_hand += 1
        try:
            async with self._push:
                await self._deliver(self.plan.push(batches) if waiting is None else waiting)
        finally:
            self._in_hand -= 1
            self._delivered.set()

    def _refused(self, deliveries: list[Delivery]) -> list[Delivery]:
        """Queue what sinks are to take, up to the first that has no room: give the rest."""
        for place, (node, batch) in enumerate(deliveries):
            if not self._queues[node].offer(batch):
                return deliveries[place:]
        return []

    async def _let_older_pass(self, status: SourceStatus) -> None:
        """Let the others give what is older: a join waits for what belongs together only so long."""
        others = [other for other in self.run.sources.values() if other is not status]
        for _ in range(PASSES):
            if not any(other.up and 0 < other.newest < status.newest for other in others):
                return
            await asyncio.sleep(0)

    async def _batches(self, node: Node, status: SourceStatus) -> AsyncGenerator[Batch]:
        """What a source gives, over all its failures."""
        retry, failed_at, reason = FIRST_RETRY, 0, ""
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
                            retry, failed_at = FIRST_RETRY, 0
                        status.up, status.error = True, ""
                        yield batch
                except Exception as error:  # noqa: BLE001 - whatever a device raises, it is tried again
                    if not failed_at:
                        failed_at, reason = status.newest or self.run.start, log_events.reason_of(error)
                        log_events.source_failed(node.name, reason)
                    status.up, status.error = False, log_events.reason_of(error)
                    status.failures += 1
                else:
                    return
                finally:
                    if isinstance(stream, AsyncGenerator):  # let go of the device before it is opened again
                        await stream.aclose()
                await asyncio.sleep(retry)
                retry = min(2 * retry, LAST_RETRY)
        finally:
            status.up = False
            if failed_at:  # it never came back
                status.gaps.append(Gap(failed_at, self.clock.now(), reason))

    async def _deliver(self, deliveries: Sequence[Delivery]) -> None:
        for node, batch in deliveries:
            await self._queues[node].put(batch)

    async def _watch_host(self) -> None:
        """Note when the host's clock is set: stamps go on, and are that much off from then on."""
        while (stray := self.clock.stray if isinstance(self.clock, LoopClock) else None) is not None:
            known = self.run.clock_steps[-1].offset if self.run.clock_steps else 0
            if abs(stray - known) >= STEP:
                self.run.clock_steps.append(ClockStep(self.clock.now(), stray))
                log_events.clock_set(stray, known)
            await asyncio.sleep(LOOK)
