"""The paper's mallet tap: held with a constant force, hit, and felt, or not.

The same grasp is also hit softly, where nothing slips: what a detector registers there is false.
"""

import math
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

import numpy as np

from connectors.sim.body import GRAVITY
from connectors.sim.lift_motion import Lift
from connectors.sim.mallet import Tap
from connectors.sim.objects import Object
from flows.lab.experiments.decisions import registered, slipping
from flows.lab.experiments.trial import By, Trace, run
from flows.lab.experiments.trial_setting import SLIDES, Conditions, Setting
from operators.batch import Counts, Reals, s
from operators.grip import GripController, StepGrip

LIFT: Final = Lift(2.0)  # until 3.1 s
BLOW: Final = 4.5  # s; by then the load of the lift has crept in
END: Final = 6.0  # s
FIRM: Final = (1.3, 1.8)  # of the least force that holds; assumed
LENGTHS: Final = (1.0, 4.0)  # mm, log-uniform, that a blow is meant to move the object by
REALLY: Final = 0.5  # mm that it has to, else another is drawn
FAR: Final = 10.0  # mm, that it may at most
DRAWS: Final = 20  # blows that are tried
SOON: Final = 0.2  # s after the blow, in which its slip has to be registered
RINGS: Final = 0.3  # s after the object has come to rest, in which a detector may still say slip
QUIET: Final = 1.0  # s before the blow, in which it may not
_NOTHING: Final = 1e-12  # N, of a step: the force is constant
_HALF: Final = 0.5
SOFT: Final = 0.15  # of the momentum that moves it: a blow that does no harm

Place: TypeAlias = Literal["top", "side"]
Ending: TypeAlias = Literal["felt", "missed", "too late", "false before", "not back to static", "dropped"]


@dataclass(frozen=True, slots=True)
class Tapping:
    """What one blow came to."""

    ending: Ending
    place: Place
    slide: float  # mm
    delay: float  # ms from the blow to the registered slip; NaN: none
    drawn: int  # blows that were drawn until one moved it
    false_lift: int  # slips registered while it was lifted with that firm grip
    false_tap: int  # slips registered at a blow that moved nothing
    false_hold: int  # and in the rest of its quiet

    @property
    def success(self) -> bool:
        """Whether it was registered, and static again."""
        return self.ending == "felt"


def tap(held: Object, seed: int, by: By, conditions: Conditions) -> tuple[Trace, Tapping]:
    """One trial, on top or on the side by turns of the seed; of the rule only its decisions count."""
    detector, grip = by
    setting = Setting.drawn(held, seed, conditions.nature)
    random = np.random.default_rng([seed, 9])
    force = setting.least * float(random.uniform(*FIRM))
    most, threshold = max(force, grip.most), grip.threshold
    constant = StepGrip(
        force=force, most=most, threshold=threshold, consecutive=grip.consecutive, step=_NOTHING
    )
    place: Place = "top" if seed % 2 else "side"
    blow, drawn = _blow(setting, place, constant, conditions, random)
    soft = replace(blow, momentum=SOFT * blow.momentum)
    trace, calm = (
        run(setting.grasp(LIFT, [each]), (detector, constant), conditions, END) for each in (blow, soft)
    )
    return trace, judged(trace, calm, grip, place, drawn)


def _blow(
    setting: Setting, place: Place, grip: GripController, conditions: Conditions, random: np.random.Generator
) -> tuple[Tap, int]:
    """A blow that moves the object, but not too far, and how many were drawn for it: no detector is asked."""
    mass, excess = setting.held.mass * setting.mass, grip.force / setting.least - (place == "top")
    heading = -1 if place == "side" and random.random() < _HALF else 1
    low, high = LENGTHS
    length = low * (high / low) ** float(random.uniform()) / 1000  # m
    momentum, drawn = mass * math.sqrt(2 * GRAVITY * excess * length), 0  # N s; friction taken as constant
    while True:
        drawn += 1
        blow = Tap(BLOW, heading * momentum, place)
        moved = _moved(run(setting.grasp(LIFT, [blow]), (Nothing(), grip), conditions, BLOW + 1))
        if REALLY <= moved <= FAR or drawn == DRAWS:
            return blow, drawn
        momentum *= float(random.uniform(1.1, 1.5) if moved < REALLY else random.uniform(0.6, 0.9))


class Nothing:
    """A detector that feels nothing."""

    name, length = "nothing", 1

    def score(self, windows: Counts | Reals) -> Reals:
        """No slip in any window (n, 1, 6); (n,)."""
        return np.zeros(len(windows))


def judged(trace: Trace, soft: Trace, grip: GripController, place: Place, drawn: int) -> Tapping:
    """What a blow, and a soft one under the same conditions, came to."""
    felt = registered(trace, grip.threshold, grip.consecutive)
    at = felt[felt >= BLOW]
    delay = float(at[0]) - BLOW if len(at) else math.nan
    after = trace.between(BLOW, END + 1)
    slides = trace.t[after][trace.speed[after] > SLIDES]
    rests = float(slides[-1]) if len(slides) else BLOW
    now = slipping(trace.probability, grip.threshold, grip.consecutive)
    ending: Ending
    if trace.dropped[-1]:
        ending = "dropped"
    elif ((felt >= BLOW - QUIET) & (felt < BLOW)).any():
        ending = "false before"
    elif math.isnan(delay) or not len(slides):
        ending = "missed"
    elif delay > SOON:
        ending = "too late"
    elif now[trace.between(rests + RINGS, END + 1)].any():
        ending = "not back to static"
    else:
        ending = "felt"
    calm = registered(soft, grip.threshold, grip.consecutive)
    calm = calm[calm > 1 + grip.settle / s]
    lifted, hit = calm < LIFT.end + RINGS, (calm >= BLOW) & (calm < BLOW + SOON + RINGS)
    return Tapping(
        ending, place, _moved(trace), 1000 * delay, drawn,
        int(lifted.sum()), int(hit.sum()) if _moved(soft) < REALLY / 10 else 0, int((~lifted & ~hit).sum()),
    )  # fmt: skip


def _moved(trace: Trace) -> float:
    """How far a blow moved the object along the pad, mm."""
    before, after = trace.between(BLOW - 0.05, BLOW), trace.between(BLOW, END + 1)
    return 1000 * float(trace.slide[after].max() - trace.slide[before][-1])
