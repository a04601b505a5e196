"""A broker that cannot be reached for long."""

import json
import time
from itertools import pairwise

from operators import s
from tests.chaos.child import until
from tests.chaos.promise import Promise
from tests.chaos.scale import Scale
from tests.chaos.subscribe import came, subscribed
from tests.chaos.world import world

TOPIC = "slip/v1/chaos/rig/0/event"
GROWTH = 20.0  # MB that the rig may grow by


def outage(scale: Scale) -> Promise:
    """Cut the line to the broker for a minute, with the events of ten."""
    length, factor = (1.5, 400) if scale.short else (60.0, 10)
    with world() as it, subscribed(it.broker.port, TOPIC, it.folder / "came"):
        time.sleep(1)
        before = it.rig.memory()
        it.line.cut()
        time.sleep(length)
        waiting, grown = len(it.missing()), it.rig.memory() - before
        it.line.mend()
        mended = time.time_ns()
        until(lambda: not any(each < mended for each in it.missing()), pause=0.1)
        found = it.finish()
        order = [json.loads(each.payload)["data"]["sample_time_ns"] for each in came(it.folder / "came")]
    order = list(dict.fromkeys(order))  # what was on the way when the line was cut came twice
    late = sum(second < first for first, second in pairwise(order))
    caught_up = (max((each.came for each in found.had if each.time <= mended), default=mended) - mended) / s
    return Promise(
        f"events: line to the broker cut for {length:g} s, as for 10 min at 1/{factor} of the rate",
        f"{found.lost} of {found.made} events lost, {late} sent out of order, {waiting} waited, "
        f"caught up {caught_up:.1f} s after it, memory {grown:+.1f} MB",
        f"0 lost, 0 out of order, at most +{GROWTH:.0f} MB",
        kept=not found.lost and not late and not found.twice and grown < GROWTH,
    )


PROMISES = [outage]
