"""Invariants that hold at the end of every simulation."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from itertools import zip_longest
from typing import TYPE_CHECKING, Final

from operators import Slips, Touch
from operators.batch import Batch
from operators.errors import SlipflowError
from storage import Session, recover, verify
from tests.faults.schedule import STALL_MAX
from tests.faults.simulated_rig import FINGERS, Identity, Life, Row, numbered_rows

if TYPE_CHECKING:
    from tests.faults.world import World

KILL_ROWS: Final = 10  # rows of a table that a kill may lose
POWER_SPAN: Final = 0.3  # s, before a power loss, whose rows and events may be lost
SAVED: Final = 0.01  # s, in which the consumer saves that an event is processed
REPAIR: Final = 0.7  # s, after a fault of the disk, in which what it delayed is written again
DISK_FAULTS: Final = frozenset({"disk full", "disk error", "fsync error", "slow disk"})


def violations(world: World) -> list[str]:
    """Return a line for each violated invariant."""
    return [*_events(world), *_recordings(world)]


def _events(world: World) -> Iterator[str]:
    """Check that the consumer received each event once, and none that the rig did not raise."""
    raised = {event for life in world.lives for event in life.started_events}
    counts = Counter(event for _, event in world.received)
    invented = counts.keys() - raised
    if invented:
        yield f"{len(invented)} events were invented: {sorted(invented)[:3]}"
    delivered: dict[Identity, float] = {}
    for when, event in world.received:
        if event in delivered and not _may_redeliver(world, event, delivered[event], when):
            yield f"event {event} was delivered at {delivered[event]:.3f} s and again at {when:.3f} s"
        delivered[event] = when
    must = {event for life in world.lives for event in _kept_events(world, life)}
    lost = must - world.processed.keys()
    if lost:
        yield f"{len(lost)} of {len(must)} events were lost: {sorted(lost)[:3]}"
    may_lose = any(life.events.keys() - world.processed.keys() for life in world.lives)
    reported = [each for each in world.reports if re.search(r" (is|are) lost", each)]
    if reported and not may_lose and not _lossy(world):
        yield f"a loss was reported, but nothing is lost: {reported[0]}"


def _may_redeliver(world: World, event: Identity, first: float, again: float) -> bool:
    """Return True if the consumer was killed while it processed an event, or saved that it had."""
    saved = world.processed.get(event, again) + SAVED
    return any(first <= kill <= min(saved, again) for kill in world.consumer_kills)


def _lossy(world: World) -> bool:
    """Return True if numbers may be lost: a power loss or a disk that failed."""
    return any(fault.kind in DISK_FAULTS | {"power loss"} for fault in world.schedule.faults)


def _kept_events(world: World, life: Life) -> Iterator[Identity]:
    """Yield the accepted events that must arrive."""
    for event, when in life.events.items():
        lost_power = _next_power_loss(world, when)
        if lost_power is not None and not _durable(world, when, min(lost_power, life.ended)):
            continue
        if life.end == "killed" and _disk_fails(world, when, life.ended):
            continue  # events in memory may be lost
        yield event


def _next_power_loss(world: World, when: float) -> float | None:
    """Return the time (s) of the first power loss after `when`."""
    return next((each for each in world.power_losses if each >= when), None)


def _durable(world: World, when: float, ended: float) -> bool:
    """Return True if what was accepted at `when` by a life that ended must survive a power loss."""
    stalled = sum(
        STALL_MAX * fault.size
        for fault in world.schedule.faults
        if fault.kind == "loop stalls" and when - STALL_MAX <= fault.start <= ended
    )
    return when < ended - POWER_SPAN - stalled and not _disk_fails(world, when, ended)


def _disk_fails(world: World, first: float, last: float) -> bool:
    """Return True if a fault of the disk delays what is accepted from `first` on beyond `last`."""
    return any(
        fault.kind in DISK_FAULTS
        and fault.start <= first + POWER_SPAN
        and fault.start + fault.duration >= last - REPAIR
        for fault in world.schedule.faults
    )


def _recordings(world: World) -> Iterator[str]:
    """Check that recovered recordings have the accepted rows, at most the promised ones missing."""
    root = world.folder / "data"
    if not root.exists():
        return
    for life in world.lives:
        folder = root / "sessions" / life.session
        if not folder.exists():
            if life.rows and life.end != "power loss":
                yield f"{life.session}: is missing, but had rows"
            continue
        try:
            if life.end != "orderly":
                recover(folder)
            yield from _rows(world, life, Session.open(folder))
            result = verify(folder)
        except SlipflowError as error:
            if any(life.rows.values()) or life.end == "orderly":
                yield f"{life.session} ({life.end}): {error}"
            continue
        allowed = {"orderly": ("note",)}.get(life.end, ("note", "repairable", "repaired", "lossy"))
        if result.worst not in allowed and not _lossy(world):
            yield f"{life.session} ({life.end}): verify says {result.worst}: {result.findings}"


def _rows(world: World, life: Life, session: Session) -> Iterator[str]:
    for kind, name in ((Touch, "Touch"), (Slips, "Slips")):
        accepted, recorded = life.rows.get(name, []), _read(session, kind)
        for finger in FINGERS:
            expected = [row for row in accepted if row[0] == finger]
            found = [row for row in recorded if row[0] == finger]
            common = min(len(expected), len(found))
            if found[:common] != expected[:common]:
                yield f"{life.session}: {name} of finger {finger} has other rows than were accepted"
            missing = expected[common:]
            if missing:
                yield from _missing(world, life, name, missing)


def _read(session: Session, kind: type[Batch]) -> list[Row]:
    """Return the rows of both fingertips, each file read once."""
    found = list[Row]()
    for batches in zip_longest(*(session.read(kind, finger) for finger in FINGERS)):
        found += [row for batch in batches if batch for row in numbered_rows(batch)]
    return found


def _missing(world: World, life: Life, name: str, missing: list[Row]) -> Iterator[str]:
    text = f"{life.session} ({life.end}): {len(missing)} accepted rows of {name} are missing"
    lost_power = _next_power_loss(world, life.ended) if life.end != "orderly" else None
    if lost_power is not None:
        when = dict(zip(life.rows[name], life.rows_at[name], strict=True))
        old = [row for row in missing if _durable(world, when[row], life.ended)]
        if old:
            yield f"{text}, {len(old)} of them older than {POWER_SPAN} s"
    elif len(missing) > (KILL_ROWS if life.end == "killed" else 0):
        yield text
