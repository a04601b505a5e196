import json
import time
from collections import Counter
from itertools import pairwise
from signal import SIGCONT, SIGSTOP

import pytest

from tests.chaos.child import SLIPFLOW, Child
from tests.chaos.subscribe import came, subscribed
from tests.chaos.world import World, world

pytestmark = pytest.mark.broker

TOPIC = "slip/v1/chaos/rig/0/event"
GROWTH = 20.0  # MB that the rig may grow by
SILENCE = 4.0  # s, longer than the rig waits for an answer


def kill_rig(it: World) -> None:
    it.rig.kill()
    it.rig.start()


def kill_broker(it: World) -> None:
    it.broker.stop()
    it.wait_for_more()
    it.broker.start()


def kill_consumer(it: World) -> None:
    it.consumer.kill()
    it.wait_for_more()
    it.consumer.start()


def stop_consumer(it: World) -> None:
    it.consumer.send(SIGSTOP)
    it.wait_for_more()
    it.consumer.send(SIGCONT)


def cut_line(it: World) -> None:
    it.line.cut()
    it.wait_for_more()
    it.line.mend()


def silence_line(it: World) -> None:
    it.line.hush()
    time.sleep(SILENCE)
    it.line.mend()


def test_whatever_is_killed_cut_or_stuck_each_event_arrives_once_and_in_order() -> None:
    """The short form of `events`, `outage`, `stuck` and `watching`, with one rig, broker and consumer."""
    with world() as it, subscribed(it.broker.port, TOPIC, it.folder / "came"):
        watch = Child(it.folder, *SLIPFLOW, "watch", it.broker.url, "--json", "--since", "start")
        watch.start()
        try:
            assert watch.wait_for(lambda: bool(watch.lines))
            kill_rig(it)
            it.wait_for_more()
            before = it.rig.memory()
            for fault in (cut_line, kill_consumer, silence_line, stop_consumer, kill_broker):
                fault(it)
                it.wait_for_more()
            grown = it.rig.memory() - before
            found = it.finish()
            wanted = {*it.made()}
            assert watch.wait_for(lambda: wanted <= {time_of(line) for line in watch.lines.copy()})
        finally:
            watch.kill()
        order = [time_of(each.payload) for each in came(it.folder / "came")]
    assert (found.lost, found.twice) == (0, 0)
    assert found.made > 50
    assert grown < GROWTH
    printed = Counter(json.loads(line)["id"] for line in watch.lines)
    assert set(printed.values()) == {1}
    order = list(dict.fromkeys(order))  # an event in flight when the line was cut is sent again
    assert not sum(second < first for first, second in pairwise(order))


def time_of(event: str | bytes) -> int:
    return int(json.loads(event)["data"]["sample_time_ns"])
