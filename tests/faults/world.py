"""One simulation: a rig that records and publishes, a broker, a consumer, and the faults of a schedule."""

import asyncio
import hashlib
import logging
import os
import time
import weakref
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache, partial
from math import inf
from operator import attrgetter
from pathlib import Path
from random import Random
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any, Final
from unittest.mock import patch

from connectors import Consumer
from connectors.mqtt import broker, broker_link, consumer, outbox, outbox_log
from flows.graph import Flow
from flows.run.live_runner import LiveRunner
from operators.errors import SlipflowError
from storage import files
from storage.background_task import BackgroundTask
from tests.faults.effects import EFFECTS
from tests.faults.invariants import CAPACITY, PART_ROWS, SMALL, excess, violations
from tests.faults.schedule import STALL_MAX, Fault, Schedule
from tests.faults.simulated_broker import SimulatedBroker
from tests.faults.simulated_disk import SimulatedDisk
from tests.faults.simulated_loop import SimulatedLoop
from tests.faults.simulated_process import Killed, SimulatedProcess, current, process_of_context
from tests.faults.simulated_rig import (
    FINGERS,
    Device,
    EveryFifth,
    Identity,
    RigRun,
    WatchedDataset,
    WatchedMqtt,
    identity,
)

START: Final = 1_700_000_000 * 10**9  # ns, host time at the start
MEMORY: Final = Path("/dev/shm")  # noqa: S108 - files in memory, which fsync does not slow down
QUIET: Final = 90.0  # s; limit for everything to arrive after the last fault
URL: Final = "mqtt://broker"
LAST: Final = "last"  # session of the run without faults
LIMIT: Final = 600.0  # s, of virtual time
REST: Final = (1.0, 1.0, 1.0, 5.0)  # s
WATCH_EVERY: Final = 0.05  # s, between two looks at the memory


@dataclass
class Outcome:
    """Result of a simulation."""

    violations: list[str]
    digest: str  # of everything that was observed; the same for the same schedule
    events: int
    rows: int


@dataclass
class World:
    """State of one simulation that the invariants examine."""

    schedule: Schedule
    folder: Path
    rig_runs: list[RigRun] = field(default_factory=list[RigRun])
    received: list[tuple[float, Identity]] = field(default_factory=list[tuple[float, Identity]])
    processed: dict[Identity, list[float]] = field(default_factory=dict)  # ends, loop time, s
    consumer_kills: list[float] = field(default_factory=list[float])
    power_losses: list[float] = field(default_factory=list[float])
    reports: list[str] = field(default_factory=list[str])
    errors: list[str] = field(default_factory=list[str])  # unexpected ones

    def __post_init__(self) -> None:
        self.random = Random(self.schedule.seed)
        self.disk: SimulatedDisk = SimulatedDisk(self.folder, Random(self.random.random()))
        self.broker: SimulatedBroker = SimulatedBroker(Random(self.random.random()))
        self.loop: SimulatedLoop = SimulatedLoop(Random(self.random.random()))
        self.loop.latency = self._latency
        self.loop.set_exception_handler(self._unhandled)
        self.devices = [Device(finger, Random(self.random.random())) for finger in FINGERS]
        self.rig: SimulatedProcess | None = None
        self.runner: LiveRunner | None = None
        self.consumer: SimulatedProcess | None = None
        self.healed = self.finished = False
        self.slow = 0.0  # s, largest latency of the slow disk
        self._step = 0  # ns, of the host's clock
        self._ends = list[tuple[float, Callable[[World], object]]]()  # loop time (s) and end of the effects

    def host_time(self) -> int:
        return START + round(self.loop.time() * 1e9) + self._step

    async def main(self) -> None:
        """Run the schedule, then let everything arrive."""
        for fault in self.schedule.faults:
            self.loop.call_at(fault.start, self._apply, fault)
        rig = self.loop.create_task(self._keep_rig())
        consumer = self.loop.create_task(self._keep_consumer())
        self._watch_memory()
        await asyncio.sleep(self.schedule.span * self.random.uniform(1.0, 1.5))
        self._heal()
        if self.runner:
            self.runner.stop()
        with suppress(TimeoutError):
            async with asyncio.timeout(QUIET):
                await rig
        with suppress(TimeoutError):
            async with asyncio.timeout(QUIET):
                await self._deliver_rest()
        self.finished = True
        if self.consumer:
            self.consumer.kill()
        await consumer

    def _watch_memory(self) -> None:
        self.errors += [each for each in excess(self) if each not in self.errors]
        if not self.finished:
            self.loop.call_later(WATCH_EVERY, self._watch_memory)

    async def _keep_rig(self) -> None:
        """Restart the rig whenever it ends, as a service manager does."""
        while not self.healed:
            await self._run_rig(RigRun(f"run-{len(self.rig_runs)}"))
            await asyncio.sleep(self.random.uniform(0.01, self.schedule.span / 3))

    async def _run_rig(self, rig_run: RigRun) -> None:
        self.rig_runs.append(rig_run)
        rig_run.started = self.loop.time()
        self.rig = SimulatedProcess("rig")
        task = self.rig.start(self._record(rig_run))
        try:
            await task
        except (Killed, asyncio.CancelledError):
            if rig_run.end != "power loss":  # without a kill, the time for its end is over
                rig_run.end = "stuck" if self.rig.alive else "killed"
        except SlipflowError as error:
            rig_run.end, rig_run.error = "refused", str(error)
        else:
            rig_run.end = "orderly" if self.rig.alive else "killed"
        rig_run.ended = rig_run.ended or self.loop.time()
        self.runner = None
        self.rig.kill()

    async def _record(self, rig_run: RigRun) -> None:
        flow = Flow("faults")
        dataset = WatchedDataset(self.folder / "data")
        dataset.part_span, dataset.part_rows = round(self.schedule.span * 0.4e9), PART_ROWS
        mqtt = WatchedMqtt(URL, outbox=self.folder / "outbox", connect_required=False)
        dataset.rig_run = mqtt.rig_run = rig_run
        dataset.capacity = mqtt.capacity = CAPACITY
        for device in self.devices:
            touch = flow.source(device)
            slips = touch | EveryFifth()
            slips.to(mqtt)
            if rig_run.session != LAST:
                touch.to(dataset)
                slips.to(dataset)
        runner = self.runner = LiveRunner(flow, rig_run.session)
        if self.healed and rig_run.session != LAST:  # stopped in the moment in which it started
            runner.stop()
        await runner.execute()
        rig_run.dropped = sum(sink.dropped for sink in runner.run.sinks.values() if sink.records)
        errors = (f" {name}: {sink.error}" for name, sink in runner.run.sinks.items() if sink.error)
        rig_run.error = "".join((runner.run.error, *errors))

    async def _keep_consumer(self) -> None:
        while not self.finished:
            self.consumer = SimulatedProcess("consumer")
            task = self.consumer.start(self._consume())
            with suppress(Killed, asyncio.CancelledError, SlipflowError):
                await task
            error = task.exception() if task.done() and not task.cancelled() else None
            if error and not isinstance(error, Killed | SlipflowError):
                self.errors.append(f"the consumer ended with {error!r}")
            self.consumer.kill()
            await asyncio.sleep(self.random.uniform(0.05, self.schedule.span / 3))

    async def _consume(self) -> None:
        position = self.folder / "consumer" / "position"
        async with Consumer(
            URL, site="lab", position_file=position, since="start", report=self.reports.append
        ) as events:
            async for event in events:
                current()
                self.received.append((self.loop.time(), identity(event)))
                if self.random.random() < 0.3:
                    await asyncio.sleep(self.random.expovariate(200))
                current()
                self.processed.setdefault(identity(event), []).append(self.loop.time())

    async def _deliver_rest(self) -> None:
        """Run the rig without devices until the consumer has all events."""
        rig_run = RigRun(LAST)
        flow_end = self.loop.create_task(self._run_rig(rig_run))
        for device in self.devices:
            device.silent_until = inf
        expected = {event for each in self.rig_runs for event in each.events}
        for _ in range(round(QUIET / 2 / 0.2)):
            if not expected - self.processed.keys():
                break
            await asyncio.sleep(0.2)
        await asyncio.sleep(self.random.choice(REST))  # duplicates and invented events arrive too
        if self.runner:
            self.runner.stop()
        await flow_end

    def _latency(self) -> float:
        process = current()
        slow = self.slow if process and process.name == "rig" else 0.0
        return self.random.uniform(20e-6, 500e-6) + self.random.uniform(0.0, slow)

    def noting_failures(self, fail: Callable[[BackgroundTask, str], None]) -> Callable[..., None]:
        """Return a method of a background task that reports its failure to the world, too."""

        def noting(task: BackgroundTask, reason: str) -> None:
            process = process_of_context()
            if process and process.alive:
                self.errors.append(f"a background task of the {process.name} died: {reason}")
            fail(task, reason)

        return noting

    def _unhandled(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        if not isinstance(context.get("exception"), Killed):
            self.errors.append(f"unhandled: {context.get('message')} {context.get('exception')!r}")

    def _apply(self, fault: Fault) -> None:
        if not self.healed:
            start, end = EFFECTS[fault.kind]
            if end and fault.start + fault.duration <= self.loop.time():
                return  # the host slept through it
            start(self, fault)
            if end:
                self._ends.append((fault.start + fault.duration, end))
                self.loop.call_at(fault.start + fault.duration, self._end_effects)

    def _end_effects(self) -> None:
        over = [end for time, end in self._ends if time <= self.loop.time()]
        self._ends = [(time, end) for time, end in self._ends if time > self.loop.time()]
        for end in over:
            end(self)

    def _heal(self) -> None:
        self.healed = True
        for _, end in EFFECTS.values():
            if end:
                end(self)
        self.disk.kill_in = 0
        for device in self.devices:
            device.failing, device.silent_until = False, 0.0

    def kill_rig(self) -> None:
        if self.rig:
            self.rig.kill()

    def kill_consumer(self) -> None:
        if self.consumer:
            self.consumer_kills.append(self.loop.time())
            self.consumer.kill()

    def lose_power(self) -> None:
        """Cut the rig's power: its process ends, and its disk keeps durable data and some of the rest."""
        if not self.rig or not self.rig_runs:
            return
        if self.rig.alive and self.rig_runs[-1].end == "running":
            self.rig_runs[-1].end, self.rig_runs[-1].ended = "power loss", self.loop.time()
        self.rig.kill()
        self.power_losses.append(self.loop.time())
        self.disk.lose_power()

    def stall(self, fault: Fault) -> None:
        """Stop everything on the rig's host for up to 0.3 s."""
        self.loop.stall(STALL_MAX * fault.size)
        self._end_effects()  # the host slept through the end of a fault, too

    def step_clock(self, fault: Fault) -> None:
        """Set the host's clock by up to an hour."""
        self._step += int((fault.size - 0.5) * 7200 * 10**9)


def simulate(schedule: Schedule, prepare: Callable[[ExitStack], object] = lambda _: None) -> Outcome:
    """Run one schedule and check the invariants.

    Args:
        schedule: Seed and faults.
        prepare: Called with a stack of contexts that last as long as the simulation; plants bugs.
    """
    folder = Path(mkdtemp(prefix="faults-", dir=MEMORY if MEMORY.is_dir() else None))
    try:
        (folder / "consumer").mkdir()
        world = World(schedule, folder)
        with _simulated(world) as stack:
            prepare(stack)
            world.loop.run_until_complete(asyncio.wait_for(world.main(), LIMIT))
            found = [*world.errors, *world.loop.failures, *violations(world)]
        rig_runs = [*map(attrgetter("session", "end", "ended", "rows", "events"), world.rig_runs)]
        observed = repr((world.received, world.reports, rig_runs, found)).replace(str(folder), "")
        return Outcome(
            [each.replace(str(folder), "") for each in found],
            hashlib.sha256(observed.encode()).hexdigest(),
            sum(len(rig_run.events) for rig_run in world.rig_runs),
            sum(len(rows) for rig_run in world.rig_runs for rows in rig_run.rows.values()),
        )
    finally:
        rmtree(folder, ignore_errors=True)


@contextmanager
def _simulated(world: World) -> Generator[ExitStack]:
    """Replace clock, randomness, disk and network of the process by those of the world."""
    random = Random(world.schedule.seed)
    quiet = logging.getLogger("slipflow")

    def token(size: int) -> str:
        return random.randbytes(size).hex()

    with ExitStack() as stack:
        enter = stack.enter_context
        stack.callback(quiet.setLevel, quiet.level)
        quiet.setLevel(logging.CRITICAL)
        finalizers = list[Callable[[], object]]()
        enter(patch.object(weakref, "finalize", partial(_finalize_at_end, finalizers)))
        enter(patch.object(time, "time_ns", world.host_time))
        enter(patch.object(time, "time", lambda: world.host_time() / 1e9))
        enter(patch.object(time, "monotonic_ns", lambda: round(world.loop.time() * 1e9)))
        enter(patch.object(time, "monotonic", world.loop.time))
        for module in (outbox, consumer):
            enter(patch.object(module, "token_hex", token))
        enter(patch.object(broker, "uniform", random.uniform))
        enter(patch.object(os, "urandom", random.randbytes))
        enter(patch.object(files, "_flock", world.disk.noting_locks(vars(files)["_flock"])))
        enter(patch.object(broker_link, "connect", world.broker.connect))
        enter(patch.object(outbox_log, "SEGMENT_EVENTS", 12))  # so that segments end within a schedule
        for module, name, small in SMALL:
            enter(patch.object(module, name, small))
        enter(patch.object(BackgroundTask, "_fail", world.noting_failures(vars(BackgroundTask)["_fail"])))
        enter(world.disk.attached())
        try:
            yield stack
        finally:
            for finalize in finalizers:  # of killed processes; later their descriptors belong to others
                finalize()
            world.disk.close_files()
            world.loop.close()


def _finalize_at_end(
    finalizers: list[Callable[[], object]], owner: object, call: Callable[..., object], *args: object
) -> Callable[[], object]:
    """Replace `weakref.finalize`: the result runs once, when it is called or at the end of the simulation."""
    finalizer = cache(partial(call, *args))
    finalizers.append(finalizer)
    return finalizer
