"""The paper's mallet tap: an object is held with constant force and hit; the detector must register the slip.

The same grasp is also hit too softly to move the object; a slip registered there is false.
"""

import math
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

import numpy as np

from connectors.sim.body import GRAVITY
from connectors.sim.grasp_actions import Lift, Tap
from connectors.sim.objects import Object
from connectors.sim.truth import SLIDING
from flows.lab.experiments.trial import Conditions, NullDetector, Trace, Trial, run_trial
from operators.batch import s
from operators.detectors import Detector
from operators.grip import GripController, StepGrip

LIFT: Final = Lift(2.0)  # until 3.1 s
BLOW: Final = 4.5  # s; by then the signal that follows the lift has settled
END: Final = 6.0  # s
FIRM: Final = (1.3, 1.8)  # range of the grip force, relative to the least that holds; assumed
SLIDES: Final = (1.0, 4.0)  # mm, log-uniform range of the slide that a blow is aimed at
LEAST_SLIDE: Final = 0.5  # mm; a blow that moves the object less is drawn again
MOST_SLIDE: Final = 10.0  # mm; a blow that moves the object more is drawn again
DRAWS: Final = 20  # blows drawn at most
PROMPT: Final = 0.2  # s from the blow; the slip must be registered within this time
RINGING: Final = 0.3  # s after the object stops; slip may still be registered then
QUIET: Final = 1.0  # s before the blow; no slip may be registered then
SOFT: Final = 0.15  # momentum of the soft blow, relative to that of the blow
_NO_STEP: Final = 1e-12  # N, force step of a constant grip
_HALF: Final = 0.5

Side: TypeAlias = Literal["top", "side"]
TapEnding: TypeAlias = Literal[
    "registered", "missed", "too late", "false before", "not back to static", "dropped"
]


@dataclass(frozen=True, slots=True)
class TapOutcome:
    """The outcome of one tap trial."""

    ending: TapEnding
    side: Side
    slide: float  # mm
    delay: float  # ms from the blow to the registered slip; NaN: none
    drawn: int  # blows drawn until one moved the object
    false_lift: int  # slips registered during the lift before the soft blow
    false_tap: int  # slips registered at the soft blow
    false_hold: int  # slips registered in the rest of the soft trial

    @property
    def success(self) -> bool:
        """True if the slip was registered in time, and static afterwards."""
        return self.ending == "registered"


def tap(
    held: Object, seed: int, detector: Detector, rule: GripController, conditions: Conditions
) -> tuple[Trace, TapOutcome]:
    """Run one tap trial, on top for odd seeds, else on the side; `rule` only sets how slips register."""
    trial = Trial.draw(held, seed, conditions)
    random = np.random.default_rng([seed, 9])
    force = trial.least_force * float(random.uniform(*FIRM))
    constant = StepGrip(
        force=force,
        max_force=max(force, rule.max_force),
        threshold=rule.threshold,
        consecutive=rule.consecutive,
        step=_NO_STEP,
    )
    side: Side = "top" if seed % 2 else "side"
    blow, drawn = _draw_blow(trial, side, constant, random)
    soft = replace(blow, momentum=SOFT * blow.momentum)
    trace, soft_trace = (
        run_trial(trial.grasp(LIFT, [each]), detector, constant, conditions, END) for each in (blow, soft)
    )
    return trace, judge_tap(trace, soft_trace, rule, side, drawn)


def _draw_blow(
    trial: Trial, side: Side, rule: GripController, random: np.random.Generator
) -> tuple[Tap, int]:
    """Draw blows until one moves the object, but not too far; return it and the number drawn."""
    mass, excess = trial.held.mass * trial.mass, rule.force / trial.least_force - (side == "top")
    heading = -1 if side == "side" and random.random() < _HALF else 1
    low, high = SLIDES
    length = low * (high / low) ** float(random.uniform()) / 1000  # m
    momentum, drawn = mass * math.sqrt(2 * GRAVITY * excess * length), 0  # N s, for constant friction
    while True:
        drawn += 1
        blow = Tap(BLOW, heading * momentum, side)
        grasp = trial.grasp(LIFT, [blow])
        slide = _slide(run_trial(grasp, NullDetector(), rule, trial.conditions, BLOW + 1))
        if LEAST_SLIDE <= slide <= MOST_SLIDE or drawn == DRAWS:
            return blow, drawn
        momentum *= float(random.uniform(1.1, 1.5) if slide < LEAST_SLIDE else random.uniform(0.6, 0.9))


def judge_tap(trace: Trace, soft: Trace, rule: GripController, side: Side, drawn: int) -> TapOutcome:
    """Return the outcome of a blow and of the soft blow under the same conditions."""
    after = trace.onsets(rule)
    after = after[after >= BLOW]
    false = soft.onsets(rule)
    false = false[false > 1 + rule.settle / s]
    lifting = false < LIFT.end + RINGING
    hit = (false >= BLOW) & (false < BLOW + PROMPT + RINGING)
    return TapOutcome(
        ending=_tap_ending(trace, rule),
        side=side,
        slide=_slide(trace),
        delay=1000 * (float(after[0]) - BLOW) if len(after) else math.nan,
        drawn=drawn,
        false_lift=int(lifting.sum()),
        false_tap=int(hit.sum()) if _slide(soft) < LEAST_SLIDE / 10 else 0,
        false_hold=int((~lifting & ~hit).sum()),
    )


def _tap_ending(trace: Trace, rule: GripController) -> TapEnding:
    onsets, rest = trace.onsets(rule), trace.between(BLOW, END + 1)
    sliding = trace.t[rest][trace.speed[rest] > SLIDING]
    after = onsets[onsets >= BLOW]
    if trace.dropped[-1]:
        return "dropped"
    if ((onsets >= BLOW - QUIET) & (onsets < BLOW)).any():
        return "false before"
    if not len(after) or not len(sliding):
        return "missed"
    if float(after[0]) - BLOW > PROMPT:
        return "too late"
    if trace.registered(rule)[trace.between(float(sliding[-1]) + RINGING, END + 1)].any():
        return "not back to static"
    return "registered"


def _slide(trace: Trace) -> float:
    """Return the distance (mm) that the blow moved the object along the pad."""
    before, after = trace.between(BLOW - 0.05, BLOW), trace.between(BLOW, END + 1)
    return 1000 * float(trace.slide[after].max() - trace.slide[before][-1])
