"""Invariants that hold at the end of every simulation, and bounds of the memory that hold all the time."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from functools import lru_cache
from itertools import zip_longest
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Final
from unittest.mock import patch

from connectors.mqtt import outbox as outbox_module
from operators import Slips, Touch
from operators.batch import Batch
from operators.errors import SlipflowError
from storage import Session, parts, recover, session, verification, verify
from storage.journal import Buffer
from tests.faults.schedule import STALL_MAX
from tests.faults.simulated_rig import (
    FINGERS,
    Identity,
    RigRun,
    Row,
    WatchedDataset,
    WatchedMqtt,
    numbered_rows,
)
from tests.inside import inside

if TYPE_CHECKING:
    from tests.faults.world import World

KILL_ROWS: Final = 10  # rows of a table that a kill may lose
POWER_SPAN: Final = 0.3  # s, before a power loss, whose rows and events may be lost
SAVED: Final = 0.01  # s, until the consumer has saved that an event is processed
REPAIR: Final = 0.7  # s after a fault of the disk, until the delayed rows and events are written; at least
RETRY: Final = 0.2  # s, first delay between two attempts, and time of an attempt
FINDINGS: Final = {  # of `verify`, by the end of a run; an orderly one is checked exactly
    "refused": ("note",),
    "killed": ("note", "repaired", "lossy"),
    "power loss": ("note", "repaired", "lossy", "lost"),
}
TASKS_MAX: Final = 24  # of a process
CAPACITY: Final = 16  # batches in the queue of a sink
PART_ROWS: Final = 100  # rows of a table in memory
EVENTS_MAX: Final = 24  # in the memory of the outbox
SMALL: Final = ((outbox_module, "MEMORY_MAX", EVENTS_MAX),)  # attributes for a simulation
DISK_FAULTS: Final = frozenset({"disk full", "disk error", "fsync error", "slow disk"})


def violations(world: World) -> list[str]:
    """Return a line for each violated invariant."""
    return [*_ends(world), *_events(world), *_recordings(world)]


def _ends(world: World) -> Iterator[str]:
    """Check that runs end in order unless a fault prevents it, and that the last one does."""
    for rig_run in world.rig_runs:
        if rig_run.end == "stuck":
            yield f"{rig_run.session}: did not end"
        if rig_run.end == "orderly" and rig_run.error:
            yield f"{rig_run.session}: ended in order, with an error: {rig_run.error}"
        if rig_run.end == "refused" and not any(
            fault.start <= rig_run.ended and rig_run.started <= fault.start + fault.duration
            for fault in world.schedule.faults
            if fault.kind in DISK_FAULTS
        ):
            yield f"{rig_run.session}: did not start although the disk works: {rig_run.error}"
    if not world.rig_runs or world.rig_runs[-1].end != "orderly":
        yield "the last run did not end in order"


def _events(world: World) -> Iterator[str]:
    """Check that the consumer received each event once, and none that the rig did not raise.

    The outbox counts events that the broker received, but forgot, while neither disk nor memory could keep
    them; the consumer reports a loss.
    """
    raised = {event for rig_run in world.rig_runs for event in rig_run.started_events}
    counts = Counter(event for _, event in world.received)
    invented = counts.keys() - raised
    if invented:
        yield f"{len(invented)} events were invented: {sorted(invented)[:3]}"
    delivered: dict[Identity, float] = {}
    for when, event in world.received:
        if event in delivered and not _may_redeliver(world, event, delivered[event], when):
            yield f"event {event} was delivered at {delivered[event]:.3f} s and again at {when:.3f} s"
        delivered[event] = when
    must = {event for rig_run in world.rig_runs for event in _kept_events(world, rig_run)}
    lost = must - world.processed.keys()
    if len(lost) > sum(rig_run.not_kept for rig_run in world.rig_runs):
        yield f"{len(lost)} of {len(must)} events were lost: {sorted(lost)[:3]}"
    reported = [each for each in world.reports if re.search(r" (is|are) lost", each)]
    if lost and not reported:
        yield f"{len(lost)} events were lost, which the consumer did not report"
    if reported and raised <= world.processed.keys():
        yield f"a loss was reported, but nothing is lost: {reported[0]}"


def _may_redeliver(world: World, event: Identity, first: float, again: float) -> bool:
    """Return True if the consumer was killed while it processed an event, or saved that it had."""
    end = next((end for end in world.processed.get(event, ()) if end >= first), again) + SAVED
    return any(first <= kill <= min(again, end + _stalled(world, end, kill)) for kill in world.consumer_kills)


def _kept_events(world: World, rig_run: RigRun) -> Iterator[Identity]:
    """Yield the accepted events that must arrive."""
    for event, when in rig_run.events.items():
        lost_power = _next_power_loss(world, when)
        ended = rig_run.ended if lost_power is None else min(lost_power, rig_run.ended)
        if lost_power is not None and not _durable(world, when, ended):
            continue
        if rig_run.end == "killed" and _disk_fails(world, when, rig_run.ended):
            continue  # events in memory may be lost
        yield event


def _next_power_loss(world: World, when: float) -> float | None:
    """Return the time (s) of the first power loss after `when`."""
    return next((each for each in world.power_losses if each >= when), None)


def _durable(world: World, when: float, ended: float) -> bool:
    """Return True if rows accepted at `when` by a run that ended at `ended` must survive a power loss."""
    stalled = _stalled(world, when, ended)
    fails = _disk_fails(world, when + stalled, ended)
    return when + stalled < ended - POWER_SPAN and not fails


def _stalled(world: World, first: float, last: float) -> float:
    """Return the largest time (s) for which everything may have stood still between two instants."""
    stalls = (each for each in world.schedule.faults if each.kind == "loop stalls")
    return sum(STALL_MAX * each.size for each in stalls if first - STALL_MAX <= each.start <= last)


def _disk_fails(world: World, first: float, last: float) -> bool:
    """Return True if a fault of the disk delays rows accepted from `first` on until after `last`."""
    failures = _disk_failures(world)
    return any(start <= first + POWER_SPAN and last <= repaired for start, repaired in failures)


def _disk_failures(world: World) -> Iterator[tuple[float, float]]:
    """Yield start and latest repair (s) of each failure of the disk.

    A fault that begins while another lasts, or before the delayed writes are tried again, prolongs the
    failure. As the delay doubles with each attempt, the next one comes at most as long after the failure as
    it has lasted. A failed fsync fails writes, too: they begin a new file, which needs an fsync.
    """
    start, end, attempt = inf, 0.0, 0.0
    for fault in sorted(world.schedule.faults, key=lambda fault: fault.start):
        if fault.kind not in DISK_FAULTS:
            continue
        if fault.start > attempt:
            yield start, max(attempt, end + REPAIR)
            start, end = fault.start, 0.0
        start, end = min(start, fault.start), max(end, fault.start + fault.duration)
        attempt = end + (end - start) + RETRY
    yield start, max(attempt, end + REPAIR)


def _recordings(world: World) -> Iterator[str]:
    """Check that recovered recordings have the accepted rows, at most the promised ones missing."""
    root = world.folder / "data"
    if not root.exists():
        return
    read_once = lru_cache(parts.read_part)  # neither reading nor verifying changes a part
    with patch.object(session, "read_part", read_once), patch.object(verification, "read_part", read_once):
        for rig_run in world.rig_runs:
            yield from _recording(world, root, rig_run)


def _recording(world: World, root: Path, rig_run: RigRun) -> Iterator[str]:
    folder = root / "sessions" / rig_run.session
    if not folder.exists():
        if rig_run.rows and rig_run.end != "power loss":
            yield f"{rig_run.session}: is missing, but had rows"
        return
    try:
        if rig_run.end != "orderly":
            recover(folder)
        recording = Session.open(folder)
        recorded = {"Touch": _read(recording, Touch), "Slips": _read(recording, Slips)}
        yield from _rows(world, rig_run, recorded)
        result = verify(folder)
    except SlipflowError as error:
        if any(rig_run.rows.values()) or rig_run.end == "orderly":
            yield f"{rig_run.session} ({rig_run.end}): {error}"
        return
    lacks = any(len(rows) > len(recorded[name]) for name, rows in rig_run.rows.items())
    cut = rig_run.end == "killed" and _next_power_loss(world, rig_run.ended) is not None
    exactly = ("lossy",) if rig_run.dropped else ("note",)
    allowed = FINDINGS.get("power loss" if cut else rig_run.end, exactly)
    if result.worst not in allowed or (lacks and result.worst == "note"):
        yield f"{rig_run.session} ({rig_run.end}): verify says {result.worst}: {result.findings}"


def _rows(world: World, rig_run: RigRun, recorded: dict[str, list[Row]]) -> Iterator[str]:
    for name, rows in recorded.items():
        for finger in FINGERS:
            expected = [row for row in rig_run.rows.get(name, []) if row[0] == finger]
            found = [row for row in rows if row[0] == finger]
            common = min(len(expected), len(found))
            if found[:common] != expected[:common]:
                yield f"{rig_run.session}: {name} of finger {finger} has other rows than were accepted"
            missing = expected[common:]
            if missing:
                yield from _missing(world, rig_run, name, missing)


def _read(recording: Session, kind: type[Batch]) -> list[Row]:
    """Return the rows of both fingertips, each file read once."""
    found = list[Row]()
    for batches in zip_longest(*(recording.read(kind, finger) for finger in FINGERS)):
        found += [row for batch in batches if batch for row in numbered_rows(batch)]
    return found


def _missing(world: World, rig_run: RigRun, name: str, missing: list[Row]) -> Iterator[str]:
    text = f"{rig_run.session} ({rig_run.end}): {len(missing)} accepted rows of {name} are missing"
    lost_power = _next_power_loss(world, rig_run.ended) if rig_run.end != "orderly" else None
    if lost_power is not None:
        when = dict(zip(rig_run.rows[name], rig_run.rows_at[name], strict=True))
        old = [row for row in missing if _durable(world, when[row], rig_run.ended)]
        if old:
            yield f"{text}, {len(old)} of them older than {POWER_SPAN} s"
    elif len(missing) > (KILL_ROWS if rig_run.end == "killed" else 0):
        yield text


def excess(world: World) -> Iterator[str]:
    """Yield a line for each process, queue or buffer that has more objects than its bound."""
    for process in (world.rig, world.consumer):
        if process and len(process.tasks) > TASKS_MAX:
            yield f"the {process.name} has {len(process.tasks)} tasks"
    if not world.runner:
        return
    for queue in inside(world.runner, "_queues").values():
        if (waiting := len(inside(queue, "_waiting"))) > CAPACITY:
            yield f"{waiting} batches wait for {queue.name}"
        if isinstance(queue.sink, WatchedDataset) and (writer := inside(queue.sink, "_writer")):
            buffers: list[dict[str, Buffer]] = [
                inside(writer, "_buffers"),
                inside(writer, "_committing") or {},
            ]
            rows = max((each["touch"].rows for each in buffers if "touch" in each), default=0)
            if rows > PART_ROWS:
                yield f"{rows} rows of a table are in memory"
        if isinstance(queue.sink, WatchedMqtt) and hasattr(queue.sink, "_outbox"):
            events = len(inside(queue.sink, "_outbox", "_memory"))
            if events > EVENTS_MAX:
                yield f"{events} events are in the memory of the outbox"
