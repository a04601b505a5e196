"""How long a loop may take: how far an object may slide, and how soon it has.

An object that is gripped too weakly stands on the table while the hand goes up. It does not fall: it slides
as fast as the hand climbs, whatever the grip. In the air it falls with what friction leaves of its weight::

    on the table   climbed(t) = way                            the same for all objects
    in the air     t = sqrt(2 way / (g (1 - grip / least)))    friction taken as constant
"""

import math
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Final

import numpy as np

from connectors.sim.body import GRAVITY
from connectors.sim.lift_motion import Lift
from connectors.sim.objects import named
from flows.lab.experiments.lifting import LAGS, LIFT, lift, raised, weak
from flows.lab.experiments.tapping import Nothing
from flows.lab.experiments.trial import BASELINE
from flows.lab.experiments.trial_setting import Conditions, Setting
from flows.run.one_thread import one_thread
from flows.run.process_map import process_map
from operators import Grip

FIRM: Final = 2.0  # times the least force, that holds it until it is in the air
AIR: Final = 4.0  # s, when the grip slackens to the weak one; the hand has stood still since 3.6
SLACKENS: Final = 1000.0  # N/s
FALLS: Final = 0.6  # s, that it is watched for
TICK: Final = 0.001  # s


@dataclass(frozen=True, slots=True)
class Budget:
    """What one trial leaves a loop, without control; times in s, NaN where the object did not get so far."""

    left: float  # m, that it may slide before the fingers lose it
    room: float  # m, that it may slide and still count as held
    share: float  # weak grip over the least that holds
    climbs: float  # s, for the room: what the hand's way up says
    climbed: float  # s, measured
    falls: float  # s, for the room in the air: what the closed form says
    fell: float  # s, measured


def budgets(
    objects: Sequence[str],
    seeds: range,
    conditions: Conditions,
    *,
    jobs: int,
    progress: Callable[[int, int, str], object] = lambda _done, _all, _part: None,
) -> dict[str, list[Budget]]:
    """The budgets of the trials of each object, by its name."""
    found = dict[str, list[Budget]]()
    of = len(objects) * len(seeds)
    work = _Work(seeds, conditions)
    with closing(process_map(work, objects, min(jobs, len(objects)))) as each:
        for number, (thing, made) in enumerate(zip(objects, each, strict=True), 1):
            found[thing] = made
            progress(number * len(seeds), of, thing)
    return found


@dataclass(frozen=True, slots=True)
class _Work:
    """Does the trials of an object; goes to processes."""

    seeds: range
    conditions: Conditions

    def __call__(self, thing: str) -> list[Budget]:
        with one_thread():
            return [budget(thing, seed, self.conditions) for seed in self.seeds]


def budget(thing: str, seed: int, conditions: Conditions) -> Budget:
    """What a trial leaves."""
    setting = Setting.drawn(named(thing), seed, conditions.nature)
    grip = weak(setting, conditions)
    left = setting.held.reach - setting.grip[1]
    room, share = min(LAGS, left), grip / setting.least
    trace, _ = lift(setting.held, seed, (Nothing(), Grip()), conditions)
    after = trace.between(LIFT.instant, math.inf)
    slid = trace.slide[after] - trace.slide[after][0]
    far = trace.t[after][(slid >= room) | trace.dropped[after]]
    return Budget(
        left,
        room,
        share,
        climbing(raised(conditions), room),
        float(far[0]) - LIFT.instant if len(far) else math.nan,
        falling(room, share),
        _fell(setting, grip, conditions, room),
    )


def climbing(up: Lift, way: float) -> float:
    """How long a hand takes to climb a way (m): s; infinite if it never does.

    >>> round(climbing(Lift(2.5), 0.02), 3)
    0.45
    """
    if way >= up.height:
        return math.inf
    t = np.linspace(0.0, up.end - up.instant, 10_001)
    return float(np.interp(way, up.climbed(up.instant + t), t))


def falling(way: float, share: float) -> float:
    """How long an object takes to slide a way (m) in the air: s; infinite if it is held.

    Args:
        way: At least 0.
        share: Of the grip in the least force that holds.

    >>> round(falling(0.024, 0.6), 3)
    0.111
    """
    return math.sqrt(2 * way / (GRAVITY * (1 - share))) if share < 1 else math.inf


def _fell(setting: Setting, grip: float, conditions: Conditions, way: float) -> float:
    """The same, measured: lifted firmly, then slackened; NaN: it did not slide so far."""
    grasp = setting.grasp(raised(conditions))
    grasp.press(FIRM * setting.least, BASELINE)
    _, held = grasp.sense(AIR)
    begun = held.slide_y
    grasp.press(grip, AIR, SLACKENS)
    for tick in range(1, round(FALLS / TICK)):
        _, held = grasp.sense(AIR + tick * TICK)
        if held.dropped or begun - held.slide_y >= way:
            return tick * TICK
    return math.nan
