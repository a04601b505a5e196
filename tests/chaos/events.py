"""Events survive the death of whoever makes, carries or takes them."""

import random
import time
from collections import Counter

from tests.chaos.promise import Promise
from tests.chaos.scale import Scale
from tests.chaos.world import world


def kills(scale: Scale) -> Promise:
    """Kill rig, broker and consumer at random times."""
    chance = random.Random(scale.seed)  # noqa: S311 - not for secrets
    count, pause = (5, 0.6) if scale.short else (42, 1.35)  # s between two, on average
    victims = (["rig", "broker", "consumer"] * 14)[:count]
    chance.shuffle(victims)
    killed = Counter[str]()
    with world() as it:
        began = time.monotonic()
        for victim in victims:
            time.sleep(pause * chance.uniform(0.5, 1.5))
            absent = pause * chance.uniform(0, 0.5)
            if victim == "broker":
                it.broker.stop()
                time.sleep(absent)
                it.broker.start()
            else:
                child = it.rig if victim == "rig" else it.consumer
                child.kill()
                time.sleep(absent)
                child.start()
            killed[victim] += 1
        took = time.monotonic() - began
        most = 50 if scale.short else 3000
        it.rig.wait_for(lambda: len(it.rig.said("event")) >= most)
        found = it.finish()
    kinds = ", ".join(f"{victim} {number}" for victim, number in sorted(killed.items()))
    return Promise(
        f"events: SIGKILL of {kinds} in {took:.0f} s, broker without persistence",
        f"{found.lost} of {found.made} events lost, {found.copies} copies removed, "
        f"{found.twice} numbers given twice",
        "0 lost, 0 twice",
        kept=not found.lost and not found.twice and found.made >= most,
        others="naive 1,155-1,453 of 2,000 lost; an outbox alone 458 of 2,201",
    )


PROMISES = [kills]
