"""A broker that is there and does not answer, and a consumer that does not read."""

import json
import signal
import time
from collections.abc import Callable
from functools import partial

from operators import EVERY, Motion, Touch
from storage import Session
from tests.chaos.promise import Promise
from tests.chaos.scale import Scale
from tests.chaos.world import World, world

LENGTH = 20  # s, of the whole test
GROWTH = 20.0  # MB that a process may grow by
QUEUED = 100  # batches that may wait for the recorder


def stopped_broker(scale: Scale) -> Promise:
    """Stop the broker and let it go on."""

    def stop(it: World) -> Callable[[], None]:
        assert it.broker.process
        it.broker.process.send_signal(signal.SIGSTOP)
        return partial(it.broker.process.send_signal, signal.SIGCONT)

    return _hold("broker stopped", stop, 2 if scale.short else LENGTH)


def silent_line(scale: Scale) -> Promise:
    """Let the broker's address take connections and never answer."""

    def hush(it: World) -> Callable[[], None]:
        it.line.hush()
        return it.line.mend

    return _hold("broker's address accepts and is silent", hush, 4 if scale.short else LENGTH)


def stopped_consumer(scale: Scale) -> Promise:
    """Stop the consumer and let it go on."""
    length = 1 if scale.short else LENGTH
    with world() as it:
        time.sleep(1)
        before = it.rig.memory(), it.broker_memory()
        it.consumer.send(signal.SIGSTOP)
        made = len(it.made())
        time.sleep(length)
        made = len(it.made()) - made
        after = it.rig.memory(), it.broker_memory()
        it.consumer.send(signal.SIGCONT)
        found = it.finish()
    grown = [later - earlier for earlier, later in zip(before, after, strict=True)]
    return Promise(
        f"events: consumer stopped for {length} s",
        f"{made} events made meanwhile, {found.lost} of {found.made} lost, "
        f"memory of the rig {grown[0]:+.1f} MB, of the broker {grown[1]:+.1f} MB",
        f"events go on, 0 lost, at most +{GROWTH:.0f} MB each",
        kept=made > _least(50, length) and not found.lost and not found.twice and max(grown) < GROWTH,
    )


def _hold(what: str, begin: Callable[[World], Callable[[], None]], length: int) -> Promise:
    with world(record=True) as it:
        time.sleep(1)
        before, first = it.rig.memory(), len(it.rig.said("status"))
        end = begin(it)
        time.sleep(length)
        grown, waiting = it.rig.memory() - before, len(it.missing())
        meanwhile = [json.loads(words)["sinks"]["dataset"] for words in it.rig.said("status")[first:]]
        end()
        found = it.finish()
        session = Session.open(min((it.folder / "dataset" / "sessions").iterdir()))
        sensed = found.status["sources"]["touch"] + found.status["sources"]["motion"]
        kept = sum(len(each) for each in (*session.read(Touch, 0), *session.read(Motion, EVERY)))
    queued = max(each["queued"] for each in meanwhile)
    rows = meanwhile[-1]["rows"] - meanwhile[0]["rows"]
    return Promise(
        f"events: {what} for {length} s while a recording runs",
        f"{waiting} events waited, {found.lost} of {found.made} lost, memory {grown:+.1f} MB; "
        f"{rows} rows recorded meanwhile, {queued} batches queued at most, "
        f"{sensed - kept} of {sensed} rows lost",
        f"0 lost of either, at most +{GROWTH:.0f} MB, {QUEUED} queued",
        kept=not found.lost
        and not found.twice
        and sensed == kept
        and grown < GROWTH
        and (queued < QUEUED or length < LENGTH)
        and rows > _least(200, length),
    )


def _least(rate: int, length: int) -> int:
    """What must at least go on in so many seconds; in the short test the machine may be busy."""
    return rate * length if length == LENGTH else 0


PROMISES = [stopped_broker, silent_line, stopped_consumer]
