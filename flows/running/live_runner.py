"""Running a flow live: a task per source, operators called inline, a bounded queue and a task per sink."""

import asyncio
import signal
from collections import defaultdict, deque
from collections.abc import AsyncGenerator, Generator, Mapping, Sequence
from contextlib import aclosing, contextmanager, suppress
from math import inf
from typing import Any

from flows.drawing import streams
from flows.graph import Flow
from flows.node import Node
from flows.plan import Delivery, Entry, Plan
from flows.running import incidents
from flows.running.clock import STEP, LoopClock
from flows.running.replay_runner import recorded_of
from operators.batch import Batch, ms
from operators.errors import EndpointError, SlipflowError
from operators.operator import Order
from operators.ports import Clock, ClockStep, Gap, Run, Sink, SinkStatus, Source, SourceStatus

FIRST_RETRY = 0.1  # s
LAST_RETRY = 5.0  # s, up to which the back-off doubles
FAREWELL = 5.0  # s, how long a failing sink is retried once the run is over
STUCK = 10.0  # s, that one write may take while others wait; then the sink counts as failing
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
    ) -> None:
        """Get ready to run `flow` as `session` until its sources end, `duration` (ns) has passed, or `stop`.

        It is a replay if a source gives what was recorded: then a run that was stopped is not complete.

        Raises:
            FlowError: if the flow is wired wrongly.
        """
        self.plan = Plan(flow)
        self.clock = clock or LoopClock()
        self._duration = duration
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
            wired=self.plan.wired,
        )
        for node, source in self._sources.items():
            self.run.describe[node.name] = source.describe()
            self.run.sources[node.name] = SourceStatus()
        self._outlets = {
            node: _Outlet(node.name, node.part, self.run.sinks.setdefault(node.name, SinkStatus()))
            for node in flow.nodes
            if isinstance(node.part, Sink)
        }
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
            for outlet in self._outlets.values():
                outlet.give_up()
        if self._stops > 2:  # noqa: PLR2004 - as said above
            for writer in self._writers:
                writer.cancel()

    async def execute(self) -> Run:
        """Run to the end.

        Raises:
            SlipflowError: if a sink cannot be opened, or an operator fails; what it gave before is committed.
        """
        opened: list[_Outlet] = []
        for source in self._sources.values():
            await source.prepare()
        self.run.start = self.clock.now()
        try:
            for outlet in self._outlets.values():
                await outlet.sink.open(self.run)
                opened.append(outlet)
        except BaseException as error:
            self.run.error = str(error) or type(error).__name__
            for outlet in opened:
                await outlet.sink.close()
            raise
        with self._signals():
            await self._carry()
        return self.run

    async def _carry(self) -> None:
        self._writers = [asyncio.create_task(outlet.carry()) for outlet in self._outlets.values()]
        readers = [asyncio.create_task(self._read(node)) for node in self._sources]
        ends: list[asyncio.Task[Any]] = [asyncio.create_task(self._stop.wait())]
        watching = asyncio.create_task(self._watch_host())
        if self._duration is not None:
            ends.append(asyncio.create_task(self.clock.sleep_until(self.run.start + self._duration)))
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
            self.run.error = _text(error)
            raise
        finally:
            tasks: list[asyncio.Task[Any]] = [*readers, *ends, watching]
            for task in tasks:
                task.cancel()
            await asyncio.gather(reading, *tasks, return_exceptions=True)
            for outlet in self._outlets.values():
                outlet.complete()
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
            if not self._outlets[node].offer(batch):
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
                            incidents.source_restarted(node.name, gap)
                            retry, failed_at = FIRST_RETRY, 0
                        status.up, status.error = True, ""
                        yield batch
                except Exception as error:  # noqa: BLE001 - whatever a device raises, it is tried again
                    if not failed_at:
                        failed_at, reason = status.newest or self.run.start, _text(error)
                        incidents.source_failed(node.name, reason)
                    status.up, status.error = False, _text(error)
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
            await self._outlets[node].put(batch)

    async def _watch_host(self) -> None:
        """Note when the host's clock is set: stamps go on, and are that much off from then on."""
        while (stray := self.clock.stray if isinstance(self.clock, LoopClock) else None) is not None:
            known = self.run.clock_steps[-1].offset if self.run.clock_steps else 0
            if abs(stray - known) >= STEP:
                self.run.clock_steps.append(ClockStep(self.clock.now(), stray))
                incidents.clock_set(stray, known)
            await asyncio.sleep(LOOK)

    @contextmanager
    def _signals(self) -> Generator[None]:
        loop = asyncio.get_running_loop()
        caught: list[signal.Signals] = []
        try:
            for number in (signal.SIGINT, signal.SIGTERM):
                loop.add_signal_handler(number, self.stop)
                caught.append(number)
        except (RuntimeError, ValueError):  # not in the main thread: whoever runs us there calls stop()
            pass
        try:
            yield
        finally:
            for number in caught:
                loop.remove_signal_handler(number)


class _Outlet:
    """A sink's queue and the task that empties it."""

    def __init__(self, name: str, sink: Sink[Any], status: SinkStatus) -> None:
        self.name, self.sink, self.status = name, sink, status
        self._waiting: deque[Batch] = deque()
        self._more, self._room = asyncio.Event(), asyncio.Event()
        self._end, self._given_up = asyncio.Event(), asyncio.Event()
        self._writing: float | None = None  # s of the loop, since when
        self._dropped_before = 0  # rows, when it last worked

    def offer(self, batch: Batch) -> bool:
        """Queue a batch if there is room, or if this sink's policy makes some."""
        if len(self._waiting) >= self.sink.capacity:
            if not self.sink.lossless:
                self._lose(self._waiting.popleft())
            elif self.status.error or self._is_stuck():  # waiting for it would stop the others
                self._lose(batch)
                return True
            else:
                return False
        self._waiting.append(batch)
        self.status.queued = len(self._waiting)
        self._more.set()
        return True

    async def put(self, batch: Batch) -> None:
        """Queue a batch, waiting for room."""
        while not self.offer(batch):
            self._room.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(STUCK):
                    await self._room.wait()

    def complete(self) -> None:
        """No more will come."""
        self._end.set()
        self._more.set()

    def give_up(self) -> None:
        """Retry no more."""
        self._given_up.set()

    async def carry(self) -> None:
        """Write what is queued until all is written, then close."""
        try:
            while self._waiting or not self._end.is_set():
                if not self._waiting:
                    self._more.clear()
                    await self._more.wait()
                    continue
                batch = self._waiting.popleft()
                self.status.queued = len(self._waiting)
                self._room.set()
                await self._write(batch)
            await self.sink.close()
        except asyncio.CancelledError:
            self._drop(*self._waiting)
            self._failed(EndpointError(self.sink.place, "was given up while it was being written"))
            raise
        except Exception as error:  # noqa: BLE001 - the others must be closed too
            self._failed(error)

    def _lose(self, batch: Batch) -> None:
        """Count a batch for which there is no room; say it once in each failure."""
        if self.status.error and self.status.dropped == self._dropped_before:
            incidents.sink_drops(self.name)
        self.status.dropped += len(batch)

    def _drop(self, *batches: Batch) -> None:
        self.status.dropped += sum(map(len, batches))
        self._waiting.clear()

    def _is_stuck(self) -> bool:
        """Whether the write at hand takes too long; it counts as failed until it ends."""
        stuck = self._writing is not None and asyncio.get_running_loop().time() - self._writing >= STUCK
        if stuck:
            self._failed(EndpointError(self.sink.place, f"has been stuck for {STUCK:.0f} s"))
        return stuck

    async def _write(self, batch: Batch) -> None:
        loop, retry, deadline = asyncio.get_running_loop(), FIRST_RETRY, inf
        while True:
            self._writing = loop.time()
            try:
                await self.sink.write(batch)
            except asyncio.CancelledError:
                self.status.dropped += len(batch)
                raise
            except Exception as error:  # noqa: BLE001 - whatever a sink raises must not stop the others
                self._failed(error)
            else:
                if self.status.error:
                    incidents.sink_restored(self.name, self.status.dropped - self._dropped_before)
                    self.status.error = ""
                self.status.rows += len(batch)
                return
            finally:
                self._writing = None
            if self._end.is_set():
                deadline = min(deadline, loop.time() + FAREWELL)
            if self._given_up.is_set() or loop.time() >= deadline:
                self._drop(batch, *self._waiting)
                return
            interrupt = self._given_up if self._end.is_set() else self._end
            with suppress(TimeoutError):
                async with asyncio.timeout(retry):
                    await interrupt.wait()
            retry = min(2 * retry, LAST_RETRY)

    def _failed(self, error: Exception) -> None:
        if not self.status.error:
            incidents.sink_failed(self.name, _text(error))
            self._dropped_before = self.status.dropped
        self.status.error = _text(error)
        self.status.failures += 1
        self._room.set()


def _text(error: Exception) -> str:
    return str(error) if isinstance(error, SlipflowError | OSError) else f"{type(error).__name__}: {error}"
