"""The paper's object lift: an object is gripped too weakly and lifted; more force must catch it.

The same grasp is also lifted firmly. A slip registered there, or before anything slides, fails the trial.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from connectors.sim.scene import Travel
from connectors.sim.simulated_rig import SLIDING
from flows.lab.experiments.trial import HELD, Outcome, Trace, Trial, run_trial
from operators.batch import Reals, s
from operators.detectors import Detector
from operators.grip import GripController

LIFT: Final = Travel(2.5)  # 50 mm at 50 mm/s, assumed; the gripper closes at 1 s
END: Final = 6.0  # s; the arm stopped 2.3 s before
WEAK: Final = (0.4, 0.8)  # range of the initial force, relative to the least expected to hold; assumed
ROOM: Final = 0.02  # m; a held object hangs at most this much lower than it was gripped
RESTS: Final = 0.0005  # m; a held object slides at most this far in the last half second
LATE: Final = 0.5  # s from the first sliding; a slip registered later counts as missed
EARLY: Final = 0.02  # s; a slip may be registered this long before the sliding it belongs to


def lift(trial: Trial, methods: Sequence[tuple[Detector, GripController]]) -> list[tuple[Trace, Outcome]]:
    """Run one lift trial.

    A delayed gripper closes later, so a rule also waits longer: scores before contact must not count.
    """
    firm, found = trial.hold((), HELD), list[tuple[Trace, Outcome]]()
    delay = round(trial.conditions.delay * s)
    for detector, usual in methods:
        rule = replace(usual, force=weak_force(trial), settle=usual.settle + delay)
        false_firm = firm.scored(detector).false_slip(rule)
        trace = run_trial(trial.grasp(LIFT), detector, rule, trial.conditions, END)
        found.append((trace, judge_lift(trace, rule, trial.least_force, false_firm=false_firm)))
    return found


def weak_force(trial: Trial) -> float:
    """Return the force (N) with which a lift begins."""
    return trial.expected_force * float(np.random.default_rng([trial.seed, 8]).uniform(*WEAK))


def judge_lift(trace: Trace, rule: GripController, least: float, *, false_firm: bool = False) -> Outcome:
    """Return the outcome of a lift; its forces are relative to `least`, which just holds the object (N).

    Endings other than ``held``: ``false slip``, registered in the firm lift or before anything slid;
    ``missed``, no slip registered within half a second of sliding; ``dropped after catch``, gripped firmly
    enough at some time; ``given up``, released by the controller; ``not lifted``, hangs too low, still slides
    or stands on the table; else ``too late``.
    """
    lifting = trace.between(LIFT.start, END + 1)
    slides = trace.t[lifting][trace.speed[lifting] > SLIDING]
    began = float(slides[0]) if len(slides) else math.inf
    onsets = trace.onsets(rule)
    answers = onsets[onsets >= began - EARLY]
    delay = float(answers[0]) - began if len(answers) else math.nan
    slide: Reals = 1000 * (trace.slide[lifting] - trace.slide[lifting][0])  # (m,) mm
    ending = _lift_ending(trace, rule, least, delay)
    if false_firm or len(answers) < len(onsets):
        ending = "false slip"
    force = trace.force[trace.between(END - 1, END + 1)]
    metrics = {
        "false_firm": false_firm,  # a slip was registered in the firm lift
        "slide": float(slide.max()),  # mm
        "lead": -1000 * delay,  # ms from the first registered slip to the first sliding
        "force": float(force.mean()) / least if _held(trace) else math.nan,  # mean of the last second
        "peak": float(trace.force.max()) / least,
    }
    return Outcome(ending, ending == "held", metrics)


def _lift_ending(trace: Trace, rule: GripController, least: float, delay: float) -> str:
    if _held(trace):
        return "held"
    if trace.commanded[-1] <= rule.min_force:
        return "given up"
    if math.isnan(delay) or delay > LATE:
        return "missed"
    if not trace.dropped[-1]:
        return "not lifted"
    return "dropped after catch" if trace.force[~trace.dropped].max() >= least else "too late"


def _held(trace: Trace) -> bool:
    """Return whether the object hangs in the gripper at the end, and no longer slides."""
    low = float(trace.gripper_height[-1] - trace.height[-1])
    lifted = not trace.dropped[-1] and not trace.on_table[-1] and low < ROOM
    return lifted and bool(np.ptp(trace.slide[trace.between(END - 0.5, END + 1)]) < RESTS)
