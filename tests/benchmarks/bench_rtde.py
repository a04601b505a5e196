"""Packages of a UR controller that a reader misses on a busy machine: ours, and ur-rtde's.

Run by `make bench`. The emulated controller sends at 125 and at 500 Hz from a process of its own, while other
processes keep the cores busy. Each reader runs in a process of its own, in turn. Ours is `UrMotion`; that of
ur-rtde is `RTDEReceiveInterface` (the extra ur), asked for stamp, pose and speed four times per package, as
it cannot tell when there is something new. A package is lost if its stamp lies between those seen and was
not seen. CPU is that of the reader's process; late: by how much more than the fastest a package is.
"""

import argparse
import asyncio
import multiprocessing
import os
import time
from collections.abc import Callable
from contextlib import aclosing
from importlib.util import find_spec
from multiprocessing.connection import Connection
from multiprocessing.synchronize import Event
from typing import Any, NamedTuple, cast

import numpy as np

from connectors import UrMotion
from connectors.emulators.ur_controller import UrController
from connectors.ur.rtde import Version
from flows.run.clocks import LoopClock
from operators import Motion, concat, ms, s
from operators.batch import Times
from tests.benchmarks.machine import commit, machine
from tests.connectors.emulators.free_arm import FreeArm

HOST = "127.0.0.5"
VERSIONS = {125.0: Version(3, 15, 8, 1), 500.0: Version(5, 11, 0, 1)}
Reader = Callable[[float, float, Connection], None]


class Seen(NamedTuple):
    """What a reader saw."""

    stamps: Times  # (n,) ns, of the controller
    arrivals: Times  # (n,) ns
    cpu: float  # s


def serve(rate: float, seed: int, ready: Event, over: Event) -> None:
    """Be the controller."""

    async def main() -> None:
        arm = FreeArm(np.random.default_rng(seed).normal(size=6))
        async with UrController(arm, host=HOST, version=VERSIONS[rate]):
            ready.set()
            while not over.is_set():  # noqa: ASYNC110 - set by another process
                await asyncio.sleep(0.1)

    asyncio.run(main())


def spin(over: Event) -> None:
    """Keep a core busy."""
    while not over.is_set():
        sum(range(100_000))


def ours(rate: float, seconds: float, result: Connection) -> None:
    """Read with `UrMotion`."""

    async def main() -> Motion:
        read, source, clock = list[Motion](), UrMotion(HOST, rate), LoopClock()
        end = clock.now() + seconds * s
        async with aclosing(cast("Any", source.batches(clock))) as batches:
            async for batch in batches:
                read.append(batch)
                if clock.now() > end:
                    break
        return concat(Motion, read)

    began = time.process_time()
    motion = asyncio.run(main())
    result.send(Seen(motion.device_time, motion.time, time.process_time() - began))


def theirs(rate: float, seconds: float, result: Connection) -> None:
    """Read with ur-rtde."""
    from rtde_receive import RTDEReceiveInterface  # type: ignore[import-not-found]  # noqa: PLC0415 - the extra ur

    receiver = cast("Any", RTDEReceiveInterface)(
        HOST, rate, ["timestamp", "actual_TCP_pose", "actual_TCP_speed"]
    )
    seen = list[tuple[float, int]]()
    began, end = time.process_time(), time.monotonic() + seconds
    while time.monotonic() < end:
        stamp = receiver.getTimestamp()
        receiver.getActualTCPPose()
        receiver.getActualTCPSpeed()
        if not seen or stamp != seen[-1][0]:
            seen.append((stamp, time.time_ns()))
        time.sleep(1 / rate / 4)
    stamps = np.rint(np.array([stamp for stamp, _ in seen]) * s).astype(np.int64)
    result.send(Seen(stamps, np.array([arrival for _, arrival in seen]), time.process_time() - began))


def measure(reader: Reader, rate: float, seconds: float, busy: int, seed: int) -> Seen:
    """Let a reader read from a controller while other processes are busy."""
    context = multiprocessing.get_context("spawn")
    ready, over = context.Event(), context.Event()
    taken, given = context.Pipe(duplex=False)
    controller = context.Process(target=serve, args=(rate, seed, ready, over))
    others = [context.Process(target=spin, args=(over,)) for _ in range(busy)]
    reading = context.Process(target=reader, args=(rate, seconds, given))
    controller.start()
    try:
        ready.wait()
        for each in (*others, reading):
            each.start()
        seen: Seen = taken.recv()
        reading.join()
    finally:
        over.set()
        for each in (controller, *others):
            each.join()
    return seen


def row(name: str, rate: float, seconds: float, seen: Seen) -> str:
    """A line of the table."""
    steps = np.rint(np.diff(seen.stamps) * rate / s)
    sent = int(steps.sum()) + 1
    lost = int((steps - 1).sum())
    lateness = (seen.arrivals - seen.stamps - (seen.arrivals - seen.stamps).min()) / ms
    late = f"{np.percentile(lateness, 50):10.2f}{np.percentile(lateness, 99):10.1f}{lateness.max():10.1f}"
    return f"{name:24}{rate:6.0f}{sent:10}{lost:8}{lost / sent:9.2%}{seen.cpu / seconds:8.1%}{late}"


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--seconds", type=float, default=10.0, help="that each reader reads; the marks took 60"
    )
    parser.add_argument("--busy", type=int, default=2, help="processes that keep the cores busy")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    readers: dict[str, Reader] = {"ours": ours}
    if find_spec("rtde_receive"):
        readers["ur-rtde"] = theirs
    print(f"seed {options.seed}, {options.seconds:.0f} s, {options.busy} busy, commit {commit()}")
    print(f"{machine()}, numpy {np.__version__}")
    print(f"load {os.getloadavg()[0]:.1f} at the beginning")
    head = f"{'packages':24}{'Hz':>6}{'sent':>10}{'lost':>8}{'':>9}{'CPU':>8}"
    print(f"{head}{'late p50':>10}{'p99':>10}{'max, ms':>10}")
    for rate in VERSIONS:
        for name, reader in readers.items():
            seen = measure(reader, rate, options.seconds, options.busy, options.seed)
            print(row(name, rate, options.seconds, seen), flush=True)


if __name__ == "__main__":
    main()
