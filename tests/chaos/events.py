"""Kills of rig, broker and consumer: no event is lost."""

import random
import time
from collections import Counter

from tests.chaos.promise import Promise
from tests.chaos.scale import Scale
from tests.chaos.system import start_system


def kills(scale: Scale) -> Promise:
    """Kill rig, broker and consumer at random times."""
    rng = random.Random(scale.seed)  # noqa: S311 - not for secrets
    count, pause = (5, 0.6) if scale.short else (42, 1.35)  # s between two, on average
    victims = (["rig", "broker", "consumer"] * 14)[:count]
    rng.shuffle(victims)
    killed = Counter[str]()
    with start_system() as system:
        began = time.monotonic()
        for victim in victims:
            time.sleep(pause * rng.uniform(0.5, 1.5))
            absent = pause * rng.uniform(0, 0.5)
            if victim == "broker":
                system.broker.stop()
                time.sleep(absent)
                system.broker.start()
            else:
                child = system.rig if victim == "rig" else system.consumer
                child.kill()
                time.sleep(absent)
                child.start()
            killed[victim] += 1
        took = time.monotonic() - began
        most = 50 if scale.short else 3000
        system.rig.wait_for(lambda: len(system.rig.lines_with("event")) >= most)
        found = system.finish()
    kinds = ", ".join(f"{victim} {number}" for victim, number in sorted(killed.items()))
    return Promise(
        f"events: SIGKILL of {kinds} in {took:.0f} s, broker without persistence",
        f"{found.lost} of {found.made} events lost, {found.duplicates} duplicates removed, "
        f"{found.reused} numbers used twice",
        "0 lost, 0 used twice",
        passed=not found.lost and not found.reused and found.made >= most,
        others="naive publisher: 1,155-1,453 of 2,000 lost; outbox alone: 458 of 2,201",
    )


PROMISES = [kills]
