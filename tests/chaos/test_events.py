import json
import time
from collections import Counter
from itertools import pairwise
from signal import SIGCONT, SIGSTOP

import pytest

from tests.chaos.child import SLIPFLOW, Child
from tests.chaos.subscribe import received, subscribed
from tests.chaos.system import System, start_system

pytestmark = pytest.mark.broker

TOPIC = "slip/v1/chaos/rig/0/event"
GROWTH = 20.0  # MB that the rig may grow by
SILENCE = 4.0  # s, longer than the rig waits for an answer


def kill_rig(system: System) -> None:
    system.rig.kill()
    system.rig.start()


def kill_broker(system: System) -> None:
    system.broker.stop()
    system.wait_for_more()
    system.broker.start()


def kill_consumer(system: System) -> None:
    system.consumer.kill()
    system.wait_for_more()
    system.consumer.start()


def stop_consumer(system: System) -> None:
    system.consumer.send(SIGSTOP)
    system.wait_for_more()
    system.consumer.send(SIGCONT)


def cut_connection(system: System) -> None:
    system.proxy.cut()
    system.wait_for_more()
    system.proxy.restore()


def silence_connection(system: System) -> None:
    system.proxy.silence()
    time.sleep(SILENCE)
    system.proxy.restore()


def test_whatever_is_killed_cut_or_stuck_each_event_arrives_once_and_in_order() -> None:
    """Short form of `events`, `outage`, `stuck` and `watching`, with one rig, broker and consumer."""
    with start_system() as system, subscribed(system.broker.port, TOPIC, system.folder / "received"):
        watch = Child(system.folder, *SLIPFLOW, "watch", system.broker.url, "--json", "--since", "start")
        watch.start()
        try:
            assert watch.wait_for(lambda: bool(watch.lines))
            kill_rig(system)
            system.wait_for_more()
            before = system.rig.memory()
            for fault in (cut_connection, kill_consumer, silence_connection, stop_consumer, kill_broker):
                fault(system)
                system.wait_for_more()
            grown = system.rig.memory() - before
            found = system.finish()
            wanted = {*system.made()}
            assert watch.wait_for(lambda: wanted <= {time_of(line) for line in watch.lines.copy()})
        finally:
            watch.kill()
        order = [time_of(each.payload) for each in received(system.folder / "received")]
    assert (found.lost, found.reused) == (0, 0)
    assert found.made > 50
    assert grown < GROWTH
    printed = Counter(json.loads(line)["id"] for line in watch.lines)
    assert set(printed.values()) == {1}
    order = list(dict.fromkeys(order))  # an event in flight when the line was cut is sent again
    assert not sum(second < first for first, second in pairwise(order))


def time_of(event: str | bytes) -> int:
    return int(json.loads(event)["data"]["sample_time_ns"])
