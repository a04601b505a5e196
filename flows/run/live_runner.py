"""Live execution of a flow: one task per source, operators called inline, one queue per sink."""

import asyncio
import gc
import logging
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from typing import Any, Final

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Delivery
from flows.graph.node import Node, check_extras, consumers, location
from flows.run.clocks import STEP, LoopClock
from flows.run.failures import contained, reason_of
from flows.run.replay_runner import close_sinks, new_run
from flows.run.sink_queue import SinkQueue
from flows.run.source_reader import SourceReader
from flows.run.supervision import ALIVE, READY, STOPPING, notify_systemd
from operators.batch import Batch, ms, s
from operators.errors import OperatorError, SlipflowError
from operators.ports import Clock, ClockStep, Run, SourceStatus

CHECK_INTERVAL: Final = 1.0  # s, between two checks of the host's clock and of silent sources
STALL: Final = 5 * s  # ns; after a longer time between two checks, the run stood still
REPORT_INTERVAL: Final = 5.0  # s, between two messages about sinks that the end of the run waits for
YIELD_EVERY: Final = 16  # rows; a source that never waits yields to the event loop after as many
CANCEL_LIMIT: Final = 5.0  # s; a source that has not ended so long after its cancellation is left alone
LAGGING: Final = 50 * ms  # ns; a source whose newest row is older is catching up, as after a host stall
PASSES: Final = 8  # passes of the event loop that a source catching up waits for older rows of the others

log = logging.getLogger("slipflow")


class LiveRunner:
    """One live run of a flow.

    A source that fails is restarted with a back-off, and its gap is recorded. A source that delivers nothing,
    or only late rows, is reported as stale. A sink that fails is retried with the same batch and never blocks
    the others. A mistake in the code of a part ends the run. While a lossless sink is slow, the sources wait;
    other sinks drop their oldest batch. A sink that is stuck counts as failing. Rows for which a failing sink
    has no room are counted as dropped. Steps of the host's clock are recorded; they do not affect time
    stamps. The run starts no thread and takes time only from its clock and the event loop. Meanwhile garbage
    collections ignore older objects (`gc.freeze`).

    Args:
        flow: Flow to run.
        session: Identifier of the run.
        clock: Clock of the run; default: `LoopClock`.
        duration: End of the run after this time, ns; default: when all sources end.

    Raises:
        FlowError: if the flow is wired wrongly, or replays a recording into a sink for live runs only.
    """

    def __init__(
        self, flow: Flow, session: str, *, clock: Clock | None = None, duration: int | None = None
    ) -> None:
        self.compiled = CompiledFlow(flow)
        check_extras(flow.nodes)
        self.clock = clock or LoopClock()
        self._duration = duration
        self.run = new_run(session, flow, self.compiled, self.clock)
        self._sources, self._stop, self._abandoned = flow.sources(), asyncio.Event(), asyncio.Event()
        self._readers = {node: SourceReader(node.name, one, self.run) for node, one in self._sources.items()}
        self._queues = {node: SinkQueue(node.name, one, self._stop.set) for node, one in flow.sinks().items()}
        self.run.sinks = {queue.name: queue.status for queue in self._queues.values()}
        self._readers_of = {
            node: [self._queues[each] for each in readers if each in self._queues]
            for node, readers in consumers(flow.nodes).items()
        }
        self._push = asyncio.Lock()  # while a sink is full, all sources wait: streams stay in order
        self._pending = 0  # batches of sources that wait for room in a queue
        self._delivered, self._ending = asyncio.Event(), False

    def stop(self) -> None:
        """End the run: flush the operators, write the queues, close the sinks.

        A second call drops the queued rows; sinks may end their write and close for `sink_queue.GRACE`. While
        the sinks are opened, it ends the run at once.
        """
        if self._stop.is_set():
            self._abandoned.set()
            for queue in self._queues.values():
                queue.abandon()
        self._stop.set()
        if self.run.recording is not None:
            self.run.error = "was interrupted"

    async def execute(self) -> Run:
        """Run until all sources end, the duration is over, or `stop` is called.

        Raises:
            SlipflowError: if a sink cannot be opened, an operator fails, a source breaks its contract or a
                sink has a mistake in its code; earlier output is committed.
        """
        self.run.start = self.clock.now()
        if not await _unless(self._abandoned, self._open_sinks()):
            self.run.error = "was stopped before it began"
            return self.run
        writers = [queue.start() for queue in self._queues.values()]
        gc.freeze()  # else a collection searches all modules, which takes 60 ms
        try:
            await self._read_all(writers)
            for queue, batch in self._enqueue(self.compiled.flush()):
                await queue.put(batch)
        except Exception as error:
            self.run.error = reason_of(error)
            raise
        finally:
            gc.unfreeze()
            await self._end_sinks(writers)
        for queue in self._queues.values():
            if queue.mistake:
                self.run.error = queue.status.error
                raise OperatorError(self.run.flow, queue.name, self.run.error) from queue.mistake
        return self.run

    async def _open_sinks(self) -> None:
        opened: list[SinkQueue] = []
        try:
            # recorders last: else a sink that refuses would leave an empty session
            for queue in sorted(self._queues.values(), key=lambda each: each.sink.records):
                try:
                    with contained():
                        await queue.sink.open(self.run)
                except SlipflowError:
                    raise
                except Exception as error:
                    reason = reason_of(error) + location(queue.sink, error)
                    raise OperatorError(self.run.flow, queue.name, reason) from error
                opened.append(queue)
        except BaseException as error:
            self.run.error = reason_of(error) if isinstance(error, Exception) else "was interrupted"
            await close_sinks((queue.sink for queue in opened), failed=True)
            raise

    async def _read_all(self, writers: Sequence[asyncio.Task[None]]) -> None:
        """Read the sources until they end, the duration is over, `stop` is called or a task fails.

        `writers` are the tasks of the queues, which end later.
        """
        notify_systemd(READY)
        readers = [asyncio.create_task(self._read(node)) for node in self._readers]
        reading = asyncio.create_task(asyncio.wait(readers, return_when=asyncio.FIRST_EXCEPTION))
        ends: list[asyncio.Task[Any]] = [
            asyncio.create_task(self._stop.wait()),
            asyncio.create_task(self._check_regularly()),
        ]
        if self._duration is not None:
            ends.append(asyncio.create_task(self.clock.sleep_until(self.clock.now() + self._duration)))
        try:
            await asyncio.wait([reading, *ends, *writers], return_when=asyncio.FIRST_COMPLETED)
            self._ending = True
            while self._pending and not reading.done():  # deliver pending batches
                self._delivered.clear()
                await self._delivered.wait()
        finally:
            errors = await _cancelled([*readers, *ends, reading], CANCEL_LIMIT)
            for reader in self._readers.values():
                reader.end()
        for error in errors:  # of an operator, a source's contract, or a task of this run
            raise error

    async def _end_sinks(self, writers: Sequence[asyncio.Task[None]]) -> None:
        """Complete the queues, and wait until all rows are written and all sinks are closed."""
        notify_systemd(STOPPING)
        for queue in self._queues.values():
            queue.complete()
        waiting = set(writers)
        try:
            while True:
                _, waiting = await asyncio.wait(waiting, timeout=REPORT_INTERVAL)
                if not waiting:
                    break
                late = [q for q, w in zip(self._queues.values(), writers, strict=True) if w in waiting]
                waited = "; ".join(q.backlog for q in late)
                log.warning("waiting for %s; a second signal drops them", waited)
        finally:
            for error in await _cancelled(writers):
                raise error

    async def _read(self, node: Node) -> None:
        """Push the batches of a source; wait only where a sink is full or others have older rows."""
        reader, push = self._readers[node], {f: self.compiled.pusher((node, f)) for f in node.fingers}
        status = reader.status

        def take(batch: Batch) -> Awaitable[bool] | None:
            pushed = push.get(batch.finger) or self.compiled.pusher((node, batch.finger))
            waiting = None if self._pending else self._enqueue(pushed(batch))
            reader.count(batch)
            due = status.rows % YIELD_EVERY < len(batch) or self.clock.now() - status.newest > LAGGING
            if due or waiting != [] or self._ending:  # else no other source runs in between
                return self._wait(batch, pushed, waiting, status)
            return None

        await reader.read(take)

    async def _wait(
        self,
        batch: Batch,
        push: Callable[[Batch], Sequence[Delivery]],
        waiting: list[tuple[SinkQueue, Batch]] | None,
        status: SourceStatus,
    ) -> bool:
        """Queue what a full queue left, or let others run; return False at the end of the run.

        If `waiting` is None, the batch was not pushed yet; it is, after those that wait for full queues.
        """
        if waiting != []:
            self._pending += 1
            try:
                async with self._push:
                    for queue, left in self._enqueue(push(batch)) if waiting is None else waiting:
                        await queue.put(left)
            finally:
                self._pending -= 1
                self._delivered.set()
        if self._ending:
            return False
        if self.clock.now() - status.newest > LAGGING:
            await self._wait_for_older_rows(status)
        if status.rows % YIELD_EVERY < len(batch):
            await asyncio.sleep(0)  # let the sinks run
        return True

    def _enqueue(self, deliveries: Sequence[Delivery]) -> list[tuple[SinkQueue, Batch]]:
        """Queue deliveries up to the first full queue; return the rest."""
        waiting: list[tuple[SinkQueue, Batch]] = []
        for node, batch in deliveries:
            for queue in self._readers_of[node]:
                if waiting or not queue.try_put(batch):
                    waiting.append((queue, batch))
        return waiting

    async def _wait_for_older_rows(self, status: SourceStatus) -> None:
        """Let other sources deliver older rows first: a join waits only for a limited time."""
        others = [other for other in self.run.sources.values() if other is not status]
        for _ in range(PASSES):
            if not any(other.up and 0 < other.newest < status.newest for other in others):
                return
            await asyncio.sleep(0)

    async def _check_regularly(self) -> None:
        """Record clock steps, silent sources and unacknowledged events, and feed the watchdog.

        The watchdog starves while a source is silent: it may hang, and a restart may help. A source that
        reports a failure does not hang.
        """
        while True:
            began = self.clock.now()
            await asyncio.sleep(CHECK_INTERVAL)
            if (waited := self.clock.now() - began) > STALL:
                cause = "a source, operator or sink blocks (Ctrl-\\ prints its line), or the host was busy"
                log.warning("the run stood still for %.1f s: %s", waited / s, cause)
            self._check_host_clock()
            for queue in self._queues.values():
                queue.observe()
            if not self._pending:  # else the sources wait for a sink
                for reader in self._readers.values():
                    reader.check(CHECK_INTERVAL)
            if not any(source.stale for source in self.run.sources.values()):
                notify_systemd(ALIVE)

    def _check_host_clock(self) -> None:
        offset = self.clock.host_offset if isinstance(self.clock, LoopClock) else 0
        known = self.run.clock_steps[-1].offset if self.run.clock_steps else 0
        if abs(offset - known) >= STEP:
            self.run.clock_steps.append(ClockStep(self.clock.now(), offset))
            step = (offset - known) / s
            log.warning("the host's clock stepped by %+.3f s; time stamps are not affected", step)


async def _unless(stop: asyncio.Event, work: Coroutine[Any, Any, None]) -> bool:
    """Run a coroutine; cancel it and return False if an event is set before it ends."""
    task, stopped = asyncio.create_task(work), asyncio.create_task(stop.wait())
    try:
        await asyncio.wait({task, stopped}, return_when=asyncio.FIRST_COMPLETED)
        if task.done():
            task.result()
        return task.done()
    finally:
        await _cancelled([task, stopped])


async def _cancelled(tasks: Sequence[asyncio.Task[Any]], limit: float | None = None) -> list[Exception]:
    """Cancel tasks, wait for their end for `limit` s at most, and return the errors of those that failed."""
    for task in tasks:
        task.cancel()
    done, _ = await asyncio.wait(tasks, timeout=limit)
    errors = (task.exception() for task in tasks if task in done and not task.cancelled())
    return [error for error in errors if isinstance(error, Exception)]
