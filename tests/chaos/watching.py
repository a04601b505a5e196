"""What `slipflow watch` prints while the rig comes and goes."""

import json
import random
import time
from collections import Counter

from tests.chaos.child import SLIPFLOW, Child, until
from tests.chaos.promise import Promise
from tests.chaos.scale import Scale
from tests.chaos.world import world


def watch(scale: Scale) -> Promise:
    """Kill the rig and start it again under a watch."""
    chance = random.Random(scale.seed)  # noqa: S311 - not for secrets
    kills = 1 if scale.short else 10
    with world() as it:
        watch = Child(it.folder, *SLIPFLOW, "watch", it.broker.url, "--json", "--since", "start")
        watch.start()
        try:
            watch.wait_for(lambda: bool(watch.lines))
            for _ in range(kills):
                time.sleep(chance.uniform(0.2, 1))
                it.rig.kill()
                it.rig.start()
                it.wait_for_more()
            wanted = {*it.made()}
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
        kept=not lost and not again,
    )


def _time(line: str) -> int:
    return int(json.loads(line)["data"]["sample_time_ns"])


PROMISES = [watch]
