"""Long outage of the connection to the broker."""

import json
import time
from itertools import pairwise

from operators import s
from tests.chaos.child import until
from tests.chaos.promise import Promise
from tests.chaos.scale import Scale
from tests.chaos.subscribe import received, subscribed
from tests.chaos.system import start_system

TOPIC = "slip/v1/chaos/rig/0/event"
GROWTH = 20.0  # MB that the rig may grow by


def outage(scale: Scale) -> Promise:
    """Cut the connection to the broker for a minute, with the events of ten minutes."""
    length, factor = (1.5, 400) if scale.short else (60.0, 10)
    with start_system() as system, subscribed(system.broker.port, TOPIC, system.folder / "received"):
        time.sleep(1)
        before = system.rig.memory()
        system.proxy.cut()
        time.sleep(length)
        waiting, grown = len(system.missing()), system.rig.memory() - before
        system.proxy.restore()
        restored = time.time_ns()
        until(lambda: not any(each < restored for each in system.missing()), pause=0.1)
        found = system.finish()
        order = [
            json.loads(each.payload)["data"]["sample_time_ns"]
            for each in received(system.folder / "received")
        ]
    order = list(dict.fromkeys(order))  # events in flight when the connection was cut arrive twice
    late = sum(second < first for first, second in pairwise(order))
    caught_up = (
        max((each.arrival for each in found.delivered if each.time <= restored), default=restored) - restored
    ) / s
    return Promise(
        f"events: connection to the broker cut for {length:g} s, equivalent to 10 min at"
        f" 1/{factor} of the rate",
        f"{found.lost} of {found.made} events lost, {late} sent out of order, {waiting} queued, "
        f"caught up {caught_up:.1f} s after reconnection, memory {grown:+.1f} MB",
        f"0 lost, 0 out of order, at most +{GROWTH:.0f} MB",
        passed=not found.lost and not late and not found.reused and grown < GROWTH,
    )


PROMISES = [outage]
