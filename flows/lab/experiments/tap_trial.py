"""The paper's mallet tap: an object is gripped firmly, lifted, and hit on top and on the side.

Both blows are drawn once, whatever they do. Each blow that moves the object must be registered as slip, and
static after it. A softer blow, the lift and the hold move nothing: a slip registered there fails the trial.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final, Literal, NamedTuple

import numpy as np

from connectors.sim.body import GRAVITY
from connectors.sim.grasp import PASSIVE_FRICTION, Tap, grip_model, surface
from connectors.sim.simulated_rig import SLIDING
from flows.lab.experiments.trial import HELD, MOVED, STILL, Outcome, Trace, Trial
from operators.detectors import Detector
from operators.grip import GripController

BLOWS: Final = (HELD, 5.0, 6.0)  # s: a soft blow, then one on top and one on the side in either order
END: Final = 7.0  # s
SLIDES: Final = (1.0, 4.0)  # mm, log-uniform range of the slide that a blow is aimed at; assumed
PROMPT: Final = 0.2  # s from the blow; the slip must be registered within this time
RINGING: Final = 0.3  # s after the object stops; slip may still be registered then
SECONDS: Final = 0.01  # s, duration of a blow
KINETIC: Final = 0.9  # friction of the first millimetres of a slide, relative to static friction; assumed
SOFT: Final = 0.15  # momentum of the soft blow, relative to a drawn one
FINGERS: Final = 3  # springs that hold the object


class _Blow(NamedTuple):
    ending: str
    slide: float  # mm
    lead: float  # ms from the registered slip to the onset of sliding; NaN: not registered


def tap(trial: Trial, methods: Sequence[tuple[Detector, GripController]]) -> list[tuple[Trace, Outcome]]:
    """Run one tap trial; the grip force is constant, so a rule only sets how slips register."""
    trace = tap_trace(trial)
    traces = [(trace.scored(detector), rule) for detector, rule in methods]
    return [(scored, judge_tap(scored, rule)) for scored, rule in traces]


def tap_trace(trial: Trial) -> Trace:
    """Simulate a tap trial without a detector."""
    return trial.hold(_draw_blows(trial), END)


def _draw_blows(trial: Trial) -> list[Tap]:
    """Draw a soft blow, and one on top and one on the side in either order."""
    random = np.random.default_rng([trial.seed, 9])
    top = _momentum(trial, trial.firm - 1, random)
    side = _momentum(trial, math.sqrt(trial.firm**2 - 1), random) * float(random.choice([-1, 1]))
    blows: list[tuple[float, Literal["top", "side"]]] = [(top, "top"), (side, "side")]
    random.shuffle(blows)
    blows.insert(0, (SOFT * blows[0][0], blows[0][1]))
    return [Tap(instant, *blow, SECONDS) for instant, blow in zip(BLOWS, blows, strict=True)]


def _momentum(trial: Trial, excess: float, random: np.random.Generator) -> float:
    """Draw a momentum (N s) that deflects fingers and rubber until they slip, and then slides the object.

    Args:
        trial: The trial.
        excess: Friction left to resist the blow, relative to the weight.
        random: Random generator of the slide.
    """
    mass = trial.held.mass * trial.mass
    weight = mass * GRAVITY  # N
    low, high = SLIDES
    slide = low * (high / low) ** float(random.uniform()) / 1000  # m
    grip = grip_model(trial.held, surface(trial.held, trial.fingertip), trial.position, PASSIVE_FRICTION)
    deflected = (weight * excess) ** 2 / (2 * FINGERS * grip.spring)  # J
    return math.sqrt(2 * mass * (weight * (KINETIC * trial.firm - 1) * slide + deflected))


def judge_tap(trace: Trace, rule: GripController) -> Outcome:
    """Return the outcome of a tap trial."""
    blows = [_judge_blow(trace, rule, start, end) for start, end in pairwise((*BLOWS, END))]
    moved = [blow for blow in blows if blow.slide >= MOVED]
    soft = [blow for blow in blows if blow.slide < STILL]
    false_firm = trace.false_slip(rule)
    ending = next((blow.ending for blow in blows if blow.ending != "registered"), "registered")
    if false_firm:
        ending = "false slip"
    if trace.dropped[-1]:
        ending = "dropped"
    leads = [blow.lead for blow in moved if not math.isnan(blow.lead)]
    metrics = {
        "false_firm": false_firm,  # a slip was registered after the gripper closed, before the first blow
        "slide": float(np.mean([blow.slide for blow in moved])) if moved else math.nan,  # mm, mean over blows
        "lead": float(np.mean(leads)) if leads else math.nan,  # ms from the registered slip to the sliding
        "moved": len(moved),  # blows that moved the object
        "soft": len(soft),  # blows that moved nothing
        "false_soft": sum(blow.ending == "false at soft blow" for blow in soft),
    }
    return Outcome(ending, ending == "registered", metrics)


def _judge_blow(trace: Trace, rule: GripController, start: float, end: float) -> _Blow:
    """Judge the time from a blow until the next one (s); a slide between soft and moved may be either."""
    onsets, rows = trace.onsets(rule), trace.between(start, end)
    onsets = onsets[(onsets >= start) & (onsets < end)]
    sliding = trace.t[rows][trace.speed[rows] > SLIDING]
    slide = trace.travel(rows)
    if slide < STILL or not len(sliding):
        return _Blow("false at soft blow" if len(onsets) else "registered", slide, math.nan)
    lead = 1000 * float(sliding[0] - onsets[0]) if len(onsets) else math.nan
    rest = trace.between(float(sliding[-1]) + RINGING, end)
    if slide >= MOVED and not len(onsets):
        return _Blow("missed", slide, lead)
    if slide >= MOVED and onsets[0] > start + PROMPT:
        return _Blow("too late", slide, lead)
    return _Blow("not back to static" if trace.registered(rule)[rest].any() else "registered", slide, lead)
