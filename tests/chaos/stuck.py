"""Broker that does not respond, and consumer that does not read."""

import json
import signal
import time
from collections.abc import Callable
from functools import partial

from operators import EVERY, Motion, Touch
from storage import Session
from tests.chaos.promise import Promise
from tests.chaos.scale import Scale
from tests.chaos.system import System, start_system

LENGTH = 20  # s, of the whole test
GROWTH = 20.0  # MB that a process may grow by
QUEUED = 100  # batches in the queue of the recorder


def stopped_broker(scale: Scale) -> Promise:
    """Stop the broker and continue it."""

    def stop(system: System) -> Callable[[], None]:
        assert system.broker.process
        system.broker.process.send_signal(signal.SIGSTOP)
        return partial(system.broker.process.send_signal, signal.SIGCONT)

    return _test_outage("broker stopped", stop, 2 if scale.short else LENGTH)


def silent_line(scale: Scale) -> Promise:
    """Let the broker's address accept connections and not respond."""

    def silence(system: System) -> Callable[[], None]:
        system.proxy.silence()
        return system.proxy.restore

    return _test_outage(
        "broker accepts connections but does not respond", silence, 4 if scale.short else LENGTH
    )


def stopped_consumer(scale: Scale) -> Promise:
    """Stop the consumer and continue it."""
    length = 1 if scale.short else LENGTH
    with start_system() as system:
        time.sleep(1)
        before = system.rig.memory(), system.broker_memory()
        system.consumer.send(signal.SIGSTOP)
        made = len(system.made())
        time.sleep(length)
        made = len(system.made()) - made
        after = system.rig.memory(), system.broker_memory()
        system.consumer.send(signal.SIGCONT)
        found = system.finish()
    growth = [later - earlier for earlier, later in zip(before, after, strict=True)]
    return Promise(
        f"events: consumer stopped for {length} s",
        f"{made} events published meanwhile, {found.lost} of {found.made} lost, "
        f"memory of the rig {growth[0]:+.1f} MB, of the broker {growth[1]:+.1f} MB",
        f"events continue, 0 lost, at most +{GROWTH:.0f} MB each",
        passed=made > _expected_rows(50, length)
        and not found.lost
        and not found.reused
        and max(growth) < GROWTH,
    )


def _test_outage(what: str, begin: Callable[[System], Callable[[], None]], length: int) -> Promise:
    with start_system(record=True) as system:
        time.sleep(1)
        before, first = system.rig.memory(), len(system.rig.lines_with("status"))
        end = begin(system)
        time.sleep(length)
        growth, waiting = system.rig.memory() - before, len(system.missing())
        meanwhile = [
            json.loads(words)["sinks"]["dataset"] for words in system.rig.lines_with("status")[first:]
        ]
        end()
        found = system.finish()
        session = Session.open(min((system.folder / "dataset" / "sessions").iterdir()))
        produced = found.status["sources"]["touch"] + found.status["sources"]["motion"]
        recorded = sum(len(each) for each in (*session.read(Touch, 0), *session.read(Motion, EVERY)))
    queued = max(each["queued"] for each in meanwhile)
    rows = meanwhile[-1]["rows"] - meanwhile[0]["rows"]
    return Promise(
        f"events: {what} for {length} s while a recording runs",
        f"{waiting} events queued, {found.lost} of {found.made} lost, memory {growth:+.1f} MB; "
        f"{rows} rows recorded meanwhile, at most {queued} batches queued, "
        f"{produced - recorded} of {produced} rows lost",
        f"0 events and rows lost, at most +{GROWTH:.0f} MB, {QUEUED} queued",
        passed=not found.lost
        and not found.reused
        and produced == recorded
        and growth < GROWTH
        and (queued < QUEUED or length < LENGTH)
        and rows > _expected_rows(200, length),
    )


def _expected_rows(rate: int, length: int) -> int:
    """Return the least number of rows in `length` s; 0 in the short test, as the machine may be busy."""
    return rate * length if length == LENGTH else 0


PROMISES = [stopped_broker, silent_line, stopped_consumer]
