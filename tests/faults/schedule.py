"""Schedules of faults: drawn from a seed, printed, and shrunk to the fewest faults."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from random import Random
from typing import Final

SPANS: Final = (0.3, 0.3, 0.6, 1.5)  # s of virtual time in which faults occur: short ones are cheaper
SPAN: Final = SPANS[-1]  # s

RARE: Final = 20  # seeds, of which one draws `LOST_PAGES`
LOST_PAGES: Final = ("fsync error", "power loss", "broker down")
STALL_MAX: Final = 0.3  # s, of the whole host

KINDS: Final = {  # of faults: maximum duration in the longest span, s; 0: momentary
    "kill rig": 0.0,  # at the next await of any task
    "kill rig at disk operation": 0.0,
    "kill consumer": 0.0,
    "power loss": 0.0,  # of the rig
    "disk full": 1.0,
    "disk error": 0.5,  # EIO
    "fsync error": 0.5,
    "slow disk": 1.5,
    "broker down": 1.5,
    "broker restart without memory": 1.0,
    "connections cut": 0.0,
    "slow network": 1.5,
    "publish refused": 1.0,
    "source fails": 0.0,
    "source silent": 1.0,
    "loop stalls": 0.0,
    "clock steps": 0.0,
}


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault: `start` and `duration` in s of virtual time, `size` from 0 to 1 as its kind needs."""

    kind: str
    start: float
    duration: float
    size: float

    def __str__(self) -> str:
        lasting = f" for {self.duration:.3f} s" if self.duration else ""
        return f"{self.start:.3f} s: {self.kind}{lasting} ({self.size:.3f})"


@dataclass(frozen=True, slots=True)
class Schedule:
    """Faults of one simulation; the seed also draws all latencies and data."""

    seed: int
    faults: tuple[Fault, ...]
    span: float = SPAN  # s


def draw(seed: int, kinds: Sequence[str] = tuple(KINDS)) -> Schedule:
    """Draw up to eight faults of at most five kinds, so that faults of a kind meet.

    Every 20th seed draws a short failure of fsync and a power loss long after it: only then do the pages that
    the kernel dropped matter, as many failures of the disk excuse the loss of most rows.
    """
    random = Random(seed)
    if seed % RARE == RARE - 1 and {*LOST_PAGES} <= {*kinds}:
        return _lose_pages(random, seed)
    kinds = random.sample(sorted(kinds), min(random.randint(1, 5), len(kinds)))
    span = SPAN if "power loss" in kinds else random.choice(SPANS)  # its promise speaks of 0.3 s
    faults = [_fault(random, random.choice(kinds), span) for _ in range(random.randint(1, 8))]
    return Schedule(seed, tuple(sorted(faults, key=lambda fault: fault.start)), span)


def shrink(schedule: Schedule, violates: Callable[[Schedule], bool]) -> Schedule:
    """Remove faults one by one as long as the schedule still violates an invariant."""
    faults, index = schedule.faults, 0
    while index < len(faults):
        fewer = replace(schedule, faults=faults[:index] + faults[index + 1 :])
        if violates(fewer):
            faults, index = fewer.faults, 0
        else:
            index += 1
    return replace(schedule, faults=faults)


def _lose_pages(random: Random, seed: int) -> Schedule:
    """Draw a short failure of fsync, a late power loss, and often a broker that is down and another fault."""
    start, end = random.uniform(0.0, 0.4), random.uniform(1.2, SPAN)
    faults = [
        Fault("fsync error", start, random.uniform(0.02, 0.2), random.random()),
        Fault("power loss", end, 0.0, random.random()),
    ]
    if random.random() < 0.5:  # otherwise events are sent before the power fails
        faults.append(Fault("broker down", random.uniform(0.0, start), SPAN, random.random()))
    if random.random() < 0.5:
        faults.append(_fault(random, random.choice(sorted(KINDS)), SPAN))
    return Schedule(seed, tuple(sorted(faults, key=lambda fault: fault.start)), SPAN)


def _fault(random: Random, kind: str, span: float) -> Fault:
    duration = random.random() * KINDS[kind] * span / SPAN
    return Fault(kind, random.uniform(0, span), duration, random.random())
