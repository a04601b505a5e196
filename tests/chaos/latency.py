"""How long it takes from a sample to whoever must know of the slip that it shows."""

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
from tests.chaos.subscribe import came, subscribed
from tests.connectors.mqtt.broker_process import TestBroker

BOUND = 15.0  # ms
TOPIC = "slip/v1/chaos/rig/0"
WARM = 100  # events that do not count


def alert(scale: Scale) -> Promise:
    """Score, record and publish at 100 Hz."""
    length, bound = (2.0, 1000.0) if scale.short else (30.0, BOUND)  # a machine may be busy in the suite
    with urgent() as priority:
        ours, load = measured(length), os.getloadavg()[0]
        plain = measured(length, naive=True) if not scale.short else None
    p50, p99 = np.percentile(ours, (50, 99))
    others = (
        ""
        if plain is None
        else "naive, here: p50 {:.0f}, p99 {:.0f} ms".format(*np.percentile(plain, (50, 99)))
    )
    return Promise(
        f"events: slip to subscriber, {len(ours)} at 100 Hz with state and signal, scored and recorded",
        f"p50 {p50:.1f}, p99 {p99:.1f} ms, {priority} priority, load {load:.1f}",
        f"p99 < {bound:.0f} ms",
        kept=bool(p99 < bound) and len(ours) >= 60 * length - WARM,
        others=others,
    )


def measured(seconds: float, *, naive: bool = False, record: bool = True) -> Reals:
    """Milliseconds from each sample to a subscriber of its own, mosquitto_sub, which tells when it came."""
    settings = ["allow_anonymous true", *(["set_tcp_nodelay false"] if naive else [])]
    with TemporaryDirectory(prefix="slipflow-chaos-") as name:
        folder = Path(name)
        broker = TestBroker(folder, *settings)
        options = ["--score", *(["--record", str(folder / "dataset")] if record else [])]
        ours = ["-m", "tests.chaos.publish", broker.url, str(folder / "outbox"), *options]
        rig = Child(folder, *(["-m", "tests.chaos.naive", str(broker.port)] if naive else ours))
        path, stray = folder / "came", 0
        try:
            with subscribed(broker.port, f"{TOPIC}/+", path):
                rig.start()
                until(lambda: path.stat().st_size > 0)
                time.sleep(seconds + WARM / 100)
                if naive:
                    rig.kill()
                else:
                    rig.end()
                    stray = abs(json.loads(rig.said("status")[-1])["host_offset"])
        finally:
            rig.kill()
            broker.close()
        found = [each for each in came(path) if each.topic == f"{TOPIC}/event"][WARM:]
    late = [each.at - json.loads(each.payload)["data"]["sample_time_ns"] + stray for each in found]
    return np.array(late) / ms


@contextmanager
def urgent() -> Generator[str]:
    """What is started meanwhile has real-time priority where that is allowed: others are not measured."""
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
