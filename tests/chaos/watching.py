"""Kills of the rig while `slipflow watch` runs."""

import json
import random
import time
from collections import Counter

from tests.chaos.child import SLIPFLOW, Child, until
from tests.chaos.promise import Promise
from tests.chaos.scale import Scale
from tests.chaos.system import start_system


def watch(scale: Scale) -> Promise:
    """Kill the rig and start it again while `slipflow watch` runs."""
    rng = random.Random(scale.seed)  # noqa: S311 - not for secrets
    kills = 1 if scale.short else 10
    with start_system() as system:
        watch = Child(system.folder, *SLIPFLOW, "watch", system.broker.url, "--json", "--since", "start")
        watch.start()
        try:
            watch.wait_for(lambda: bool(watch.lines))
            for _ in range(kills):
                time.sleep(rng.uniform(0.2, 1))
                system.rig.kill()
                system.rig.start()
                system.wait_for_more()
            wanted = {*system.made()}
            until(lambda: wanted <= {_time(line) for line in watch.lines.copy()}, pause=0.5)
        finally:
            watch.kill()
    printed = Counter(json.loads(line)["id"] for line in watch.lines)
    lost = len(wanted - {_time(line) for line in watch.lines})
    again = sum(number > 1 for number in printed.values())
    return Promise(
        f"events: rig killed {kills} times under `slipflow watch`",
        f"{lost} of {len(wanted)} events not printed, {again} printed twice",
        "0, 0",
        passed=not lost and not again,
    )


def _time(line: str) -> int:
    return int(json.loads(line)["data"]["sample_time_ns"])


PROMISES = [watch]
