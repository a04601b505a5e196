"""Delay from a sample to the subscriber of its slip event."""

import json
import os
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from operators import ms
from operators.batch import Reals
from tests.chaos.child import Child, until
from tests.chaos.promise import Promise
from tests.chaos.scale import Scale
from tests.chaos.subscribe import received, subscribed
from tests.connectors.mqtt.broker_process import TestBroker

BOUND = 15.0  # ms
TOPIC = "slip/v1/chaos/rig/0"
WARM = 100  # first events, which do not count


def alert(scale: Scale) -> Promise:
    """Measure the delay while the rig scores, records and publishes at 100 Hz."""
    length, bound = (
        (2.0, 1000.0) if scale.short else (30.0, BOUND)
    )  # the machine may be busy while the suite runs
    with real_time_priority() as priority:
        delays, load = measure_latency(length), os.getloadavg()[0]
        naive_delays = measure_latency(length, naive=True) if not scale.short else None
    p50, p99 = np.percentile(delays, (50, 99))
    others = (
        ""
        if naive_delays is None
        else "naive publisher on this machine: p50 {:.0f}, p99 {:.0f} ms".format(
            *np.percentile(naive_delays, (50, 99))
        )
    )
    return Promise(
        f"events: delay from sample to subscriber, {len(delays)} events at 100 Hz with state and"
        " signal, scored and recorded",
        f"p50 {p50:.1f}, p99 {p99:.1f} ms, {priority} priority, load {load:.1f}",
        f"p99 < {bound:.0f} ms",
        passed=bool(p99 < bound) and len(delays) >= 60 * length - WARM,
        others=others,
    )


def measure_latency(seconds: float, *, naive: bool = False, record: bool = True) -> Reals:
    """Return the delay (ms) from each sample to an independent subscriber, mosquitto_sub."""
    settings = ["allow_anonymous true", *(["set_tcp_nodelay false"] if naive else [])]
    with TemporaryDirectory(prefix="slipflow-chaos-") as name:
        folder = Path(name)
        broker = TestBroker(folder, *settings)
        options = ["--score", *(["--record", str(folder / "dataset")] if record else [])]
        publisher = ["-m", "tests.chaos.publish", broker.url, str(folder / "outbox"), *options]
        rig = Child(folder, *(["-m", "tests.chaos.naive", str(broker.port)] if naive else publisher))
        path, clock_offset = folder / "received", 0
        try:
            with subscribed(broker.port, f"{TOPIC}/+", path):
                rig.start()
                until(lambda: path.stat().st_size > 0)
                time.sleep(seconds + WARM / 100)
                if naive:
                    rig.kill()
                else:
                    rig.end()
                    clock_offset = abs(json.loads(rig.lines_with("status")[-1])["host_offset"])
        finally:
            rig.kill()
            broker.close()
        found = [each for each in received(path) if each.topic == f"{TOPIC}/event"][WARM:]
    late = [each.at - json.loads(each.payload)["data"]["sample_time_ns"] + clock_offset for each in found]
    return np.array(late) / ms


@contextmanager
def real_time_priority() -> Generator[str]:
    """Give child processes real-time priority if allowed, so that other processes do not affect them."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except OSError:
        yield "normal"
        return
    try:
        yield "real-time"
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


PROMISES = [alert]
