"""CPU of the whole live path: three fingertips at 100 Hz and an arm at 500 Hz, scored and recorded.

Run by `make bench`. `TakkTile` reads an emulated bus through smbus2, `UrMotion` an emulated controller over
loopback; `DeviceClock`, `Zero`, `Align`, `Label`, the trained `Score` and `Debounce` follow. What was
received and the samples go to a `Dataset`, the events to a sink that keeps them. The controller has a process
of its own. The bus cannot: its fingertips feel counts from a table, made before, and what the emulation costs
is timed at smbus2's calls into the operating system, and subtracted. The operators are timed, too. The first
seconds do not count. CPU is that of the process, in % of one core.
"""

import asyncio
import multiprocessing
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import aclosing
from multiprocessing.connection import Connection
from multiprocessing.synchronize import Event
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
import smbus2.smbus2

from connectors import TakkTile, UrMotion
from connectors.sim.finger import Finger
from connectors.sim.scene import Scene
from flows.graph import Flow
from flows.graph.testing import TestSink
from flows.run.live_runner import LiveRunner
from operators import Align, Batch, Clock, DeviceClock, Label, Score, Touch, Zero, ms, s
from storage import Dataset, load_debounce, load_detector
from tests.benchmarks.machine import print_head
from tests.emulators.i2c_bus import EmulatedI2cBus, Table, served
from tests.emulators.ur_controller import ANYWHERE, E_SERIES, UrController

P = ParamSpec("P")
T = TypeVar("T")

HOST = "127.0.0.6"
BUS = "/dev/i2c-99"
FINGERS = (0, 1, 2)
SECONDS = 20.0  # that are measured
WARM = 3.0  # s that do not count: `Zero` learns its baseline


class Noting(TakkTile):
    """Writes down when each sample comes into the event loop."""

    def __init__(self) -> None:
        super().__init__(BUS, FINGERS)
        self.arrivals = dict[tuple[int, int], int]()  # ns, by finger and stamp

    async def batches(self, clock: Clock) -> AsyncIterator[Touch]:
        """Hand on."""
        async with aclosing(cast("Any", super().batches(clock))) as batches:
            async for batch in batches:
                self.arrivals[batch.finger, batch.time.item()] = clock.now()
                yield batch


class Told(TestSink):
    """Writes down when each event comes."""

    def __init__(self) -> None:
        super().__init__()
        self.events = list[tuple[int, int, int]]()  # finger, stamp of the deciding sample, now; ns

    def take(self, batch: Batch) -> bool:
        """Write down."""
        now = self.run.clock.now()
        self.events += [(batch.finger, time, now) for time in batch.time.tolist()]
        return True


class Spent:
    """CPU time of what is called, by name; what reading the clock adds is taken out."""

    def __init__(self) -> None:
        self._total, self._calls = defaultdict[str, int](int), defaultdict[str, int](int)
        nothing = self.timed("", lambda: None)
        for _ in range(10_000):
            nothing()
        self._clock = self._total.pop("") / self._calls.pop("")  # ns a call

    def timed(self, name: str, call: Callable[P, T]) -> Callable[P, T]:
        """The same, timed; calls of one name may not overlap."""

        def timing(*args: P.args, **kwargs: P.kwargs) -> T:
            began = time.thread_time_ns()
            try:
                return call(*args, **kwargs)
            finally:
                self._total[name] += time.thread_time_ns() - began
                self._calls[name] += 1

        return timing

    def seconds(self) -> dict[str, float]:
        """So far, s by name."""
        return {name: (total - self._calls[name] * self._clock) / s for name, total in self._total.items()}

    def used(self) -> dict[str, float]:
        """Return what was used so far, s: wall time, CPU of the process, of its threads and of the parts."""
        threads = {
            each.name: time.clock_gettime(time.pthread_getcpuclockid(each.ident))
            for each in threading.enumerate()
            if each.ident is not None
        }
        return {"wall": time.monotonic(), "process": time.process_time(), **threads, **self.seconds()}


def serve(port: Connection, over: Event) -> None:
    """Be the controller."""

    async def main() -> None:
        async with UrController(np.zeros(6), host=HOST, ports=ANYWHERE, version=E_SERIES) as controller:
            port.send(controller.ports.rtde)
            while not over.is_set():  # noqa: ASYNC110 - set by another process
                await asyncio.sleep(0.1)

    asyncio.run(main())


def declared(touch: TakkTile, motion: UrMotion, told: Told, out: str) -> Flow:
    """The flow that is measured."""
    flow, dataset = Flow("path"), Dataset(out)
    pressed, moved = flow.source(touch, "touch"), flow.source(motion, "motion")
    zeroed = pressed | Zero()
    samples = zeroed & (moved | DeviceClock()) | Align(within=20 * ms) | Label(speed=0.003)
    pressed.to(dataset)
    moved.to(dataset)
    samples.to(dataset)
    (zeroed | Score(load_detector("tcn")) | load_debounce("tcn")).to(told)
    return flow


async def run(port: int) -> str:
    """Run the flow, time its parts, and return the tables."""
    spent, touch, told = Spent(), Noting(), Told()
    motion = UrMotion(HOST, 500.0, port=port)
    taken = [Finger(Scene(), 0, finger).take(round((SECONDS + WARM) * 100)) for finger in FINGERS]
    bus = EmulatedI2cBus(
        Table(*(each[0].counts for each in taken if each is not None)), {each: each for each in FINGERS}
    )
    with tempfile.TemporaryDirectory() as out, served(bus, BUS):
        runner = LiveRunner(declared(touch, motion, told, out), "path")
        names, pusher = smbus2.smbus2.__dict__, runner.compiled.pusher
        names["ioctl"] = spent.timed("bus", names["ioctl"])
        vars(runner.compiled)["pusher"] = lambda *entries: spent.timed("operators", pusher(*entries))
        running = asyncio.create_task(runner.execute())
        await asyncio.sleep(WARM)
        first = spent.used()
        await asyncio.sleep(SECONDS)
        last = spent.used()
        runner.stop()
        result = await running
    wall = last["wall"] - first["wall"]
    shares = {name: (last[name] - value) / wall for name, value in first.items()}  # CPU, of one core
    dataset = result.sinks["dataset"]
    rows = {name: (each.rows, each.missing) for name, each in result.sources.items()}
    rows["dataset"] = dataset.rows, dataset.dropped
    delays = [
        ((now - touch.arrivals[finger, stamp]) / ms, (now - stamp) / ms) for finger, stamp, now in told.events
    ]
    return "\n".join(
        [
            *cpu_table(shares),
            f"{'rows':20}{'in':>10}{'missing':>10}",
            *(f"{name:20}{came:10}{missing:10}" for name, (came, missing) in rows.items()),
            *delay_table(delays),
        ]
    )


def cpu_table(shares: dict[str, float]) -> Iterator[str]:
    """Yield the lines about the CPU, in shares of one core."""
    process, bus, operators = shares["process"], shares["bus"], shares["operators"]
    loop, scanning = shares["MainThread"], shares[f"takktile {BUS}"]
    yield "CPU, % of one core"
    for name, value in {
        "whole process": process,
        "the emulated bus in it": bus,
        "without it": process - bus,
        "  scanning: smbus2, TakkTile": scanning - bus,
        "  writing": process - loop - scanning,
        "  event loop": loop,
        "    operators": operators,
        "    the rest: RTDE, queues, recording": loop - operators,
    }.items():
        yield f"{name:40}{value:8.1%}"


def delay_table(delays: list[tuple[float, float]]) -> Iterator[str]:
    """Yield the lines about the delays of the events, ms: since a sample arrived, and was converted."""
    yield f"{'ms to the event':20}{'events':>10}{'p50':>10}{'p99':>10}"
    for name, column in zip(("from the arrival", "from the touch"), zip(*delays, strict=True), strict=True):
        p50, p99 = np.percentile(column, (50, 99))
        yield f"{name:20}{len(delays):10}{p50:10.2f}{p99:10.2f}"


def main() -> None:
    """Measure and print the tables."""
    print_head(f"{SECONDS:.0f} s")
    context = multiprocessing.get_context("spawn")
    over, (taken, given) = context.Event(), context.Pipe(duplex=False)
    controller = context.Process(target=serve, args=(given, over))
    controller.start()
    try:
        print(asyncio.run(run(taken.recv())))
    finally:
        over.set()
        controller.join()


if __name__ == "__main__":
    main()
