"""The paper's object lift: an object is gripped too weakly and lifted; more force must catch it."""

import math
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

import numpy as np

from connectors.sim.grasp_actions import Lift
from connectors.sim.objects import Object
from connectors.sim.truth import SLIDING
from flows.lab.experiments.trial import BASELINE, Conditions, Trace, Trial, run_trial
from operators.batch import Reals, s
from operators.detectors import Detector
from operators.grip import GripController

LIFT: Final = Lift(2.5)  # 50 mm at 50 mm/s, assumed; the gripper closes at 1 s
END: Final = 6.0  # s; the arm stopped 2.3 s before
WEAK: Final = (0.4, 0.8)  # range of the initial force, relative to the least expected to hold; assumed
ROOM: Final = 0.02  # m; a held object hangs at most this much lower than it was gripped
RESTS: Final = 0.0005  # m; a held object slides at most this far in the last half second
LATE: Final = 0.5  # s from the first sliding; a slip registered later counts as missed
EARLY: Final = 0.02  # s; a slip may be registered this long before the sliding it belongs to

LiftEnding: TypeAlias = Literal["held", "missed", "too late", "dropped after catch", "given up", "not lifted"]


@dataclass(frozen=True, slots=True)
class LiftOutcome:
    """The outcome of one lift.

    Endings other than ``held``: ``missed``, no slip registered within half a second of sliding; ``dropped
    after catch``, gripped firmly enough at some time; ``given up``, released by the controller; ``not
    lifted``, hangs too low, still slides or stands on the table; else ``too late``.
    """

    ending: LiftEnding
    slide: float  # mm
    delay: float  # ms from the first sliding to the first registered slip; NaN: none
    ratio: float  # mean force of the last second over the least that holds; NaN: not held
    peak: float  # highest force over the least that holds
    false: int  # slips registered before anything slid
    firm: float = math.nan  # s from the start of the lift until the grip is firm enough; NaN: never
    lost: bool = False  # fell out of the gripper

    @property
    def success(self) -> bool:
        """True if the object was lifted and held."""
        return self.ending == "held"


def lift(
    held: Object, seed: int, detector: Detector, rule: GripController, conditions: Conditions
) -> tuple[Trace, LiftOutcome]:
    """Run one lift trial; `rule` begins with the weak force of the trial.

    A delayed gripper closes later, so `rule` also waits longer: scores before contact must not count.
    """
    trial = Trial.draw(held, seed, conditions)
    settle = rule.settle + round(conditions.gripper.delay * s)
    rule = replace(rule, force=weak_force(trial), settle=settle)
    trace = run_trial(trial.grasp(lift_motion(conditions)), detector, rule, conditions, END)
    return trace, judge_lift(trace, rule, trial.least_force)


def weak_force(trial: Trial) -> float:
    """Return the force (N) with which a lift begins."""
    share = float(np.random.default_rng([trial.seed, 8]).uniform(*WEAK))
    return trial.expected_force * share * trial.conditions.grip


def lift_motion(conditions: Conditions) -> Lift:
    """Return the arm's motion."""
    pace = conditions.pace
    return replace(LIFT, speed=pace * LIFT.speed, acceleration=pace * LIFT.acceleration)


def judge_lift(trace: Trace, rule: GripController, least: float) -> LiftOutcome:
    """Return the outcome of a lift; `least` is the least force that holds the object (N)."""
    lifting = trace.between(LIFT.instant, END + 1)
    slides = trace.t[lifting][trace.speed[lifting] > SLIDING]
    began = float(slides[0]) if len(slides) else math.inf
    onsets = trace.onsets(rule)
    onsets = onsets[onsets > BASELINE + rule.settle / s]
    answers = onsets[onsets >= began - EARLY]
    delay = float(answers[0]) - began if len(answers) else math.nan
    slide: Reals = 1000 * (trace.slide[lifting] - trace.slide[lifting][0])  # (m,) mm
    ending = _lift_ending(trace, rule, least, delay)
    force = trace.force[trace.between(END - 1, END + 1)]
    firm = trace.t[lifting][trace.force[lifting] >= least]
    return LiftOutcome(
        ending=ending,
        slide=float(slide.max()),
        delay=1000 * delay,
        ratio=float(force.mean()) / least if ending == "held" else math.nan,
        peak=float(trace.force.max()) / least,
        false=int((onsets < began - EARLY).sum()),
        firm=float(firm[0]) - LIFT.instant if len(firm) else math.nan,
        lost=bool(trace.dropped[-1]),
    )


def _lift_ending(trace: Trace, rule: GripController, least: float, delay: float) -> LiftEnding:
    last = trace.between(END - 0.5, END + 1)
    dropped = bool(trace.dropped[-1])
    low = float(trace.gripper_height[-1] - trace.height[-1])
    if not dropped and not trace.on_table[-1] and low < ROOM and np.ptp(trace.slide[last]) < RESTS:
        return "held"
    if trace.commanded[-1] <= rule.min_force:
        return "given up"
    if math.isnan(delay) or delay > LATE:
        return "missed"
    if not dropped:
        return "not lifted"
    return "dropped after catch" if trace.force[~trace.dropped].max() >= least else "too late"
