"""The paper's experiments: the mallet tap and the object lift.

Tap: an object is gripped firmly, lifted, and hit on top and on the side. Both blows are drawn once, whatever
they do. Each blow that moves the object must be registered as slip, and static after it. A softer blow, the
lift and the hold move nothing: a slip registered there fails the trial.

Lift: an object is gripped too weakly and lifted; more force must catch it. The same grasp is also lifted
firmly. A slip registered there, or before anything slides, fails the trial.

Success is judged strictly, as above, and by the paper's definition, which asks less: both blows are
registered and static again after the object has stopped; a slip is registered, and the object is held at the
end.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final, Literal, NamedTuple

import numpy as np

from connectors.sim.grasp import Tap, blow_momentum, grip_model, surface
from connectors.sim.scene import Travel, log_uniform
from connectors.sim.simulated_rig import SLIDING
from flows.lab.experiments.trial import HELD, MOVED, PROMPT, STILL, Outcome, Trace, Trial, control_trial
from operators.batch import Reals, s
from operators.detectors import Detector
from operators.grip import GripController

BLOWS: Final = (HELD, 5.0, 6.0)  # s: a soft blow, then one on top and one on the side in either order
TAP_END: Final = 7.0  # s
SLIDES: Final = (1.0, 4.0)  # mm, log-uniform range of the slide that a blow is aimed at; assumed
RINGING: Final = 0.3  # s after the object stops; slip may still be registered then
SECONDS: Final = 0.01  # s, duration of a blow
SIZES: Final = {"0.5 to 1 mm": (MOVED, 1.0), "1 to 2 mm": (1.0, 2.0), "above 2 mm": (2.0, math.inf)}  # slides
SOFT: Final = 0.15  # momentum of the soft blow, relative to a drawn one

LIFT: Final = Travel(2.5)  # 50 mm at 50 mm/s, assumed; the gripper closes at 1 s
LIFT_END: Final = 6.0  # s; the arm stopped 2.3 s before
WEAK: Final = (0.4, 0.8)  # range of the initial force, relative to the least expected to hold; assumed
ROOM: Final = 0.02  # m; a held object hangs at most this much lower than it was gripped
RESTS: Final = 0.0005  # m; a held object slides at most this far in the last half second
LATE: Final = 0.5  # s from the first sliding; a slip registered later counts as missed
EARLY: Final = 0.02  # s; a slip may be registered this long before the sliding it belongs to


class _Blow(NamedTuple):
    ending: str
    slide: float  # mm, of the pad
    still: bool  # no finger slipped
    lead: float  # ms from the registered slip to the onset of sliding; NaN: not registered
    paper: bool  # success by the paper's definition


def tap(trial: Trial, methods: Sequence[tuple[Detector, GripController]]) -> list[tuple[Trace, Outcome]]:
    """Run one tap trial; the grip force is constant, so a rule only sets how slips register."""
    trace = trial.hold(_draw_blows(trial), TAP_END)
    detectors = {id(detector): detector for detector, _ in methods}  # one may come with several rules
    traces = {key: trace.scored(detector) for key, detector in detectors.items()}
    scored = [(traces[id(detector)], rule) for detector, rule in methods]
    return [(each, judge_tap(each, rule)) for each, rule in scored]


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
    """Draw a momentum (N s); `excess` is the friction left to resist the blow, relative to the weight."""
    grip = grip_model(trial.held, surface(trial.held, trial.fingertip), trial.position)
    return blow_momentum(grip, trial.firm, excess, log_uniform(random, *SLIDES) / 1000)


def judge_tap(trace: Trace, rule: GripController) -> Outcome:
    """Return the outcome of a tap trial."""
    blows = [_judge_blow(trace, rule, start, end) for start, end in pairwise((*BLOWS, TAP_END))]
    moved = [blow for blow in blows if blow.slide >= MOVED]
    soft = [blow for blow in blows if blow.still]
    false_slips = trace.false_slips(rule)
    ending = next((blow.ending for blow in blows if blow.ending != "registered"), "registered")
    if false_slips["false_firm"]:
        ending = "false slip"
    if trace.dropped[-1]:
        ending = "dropped"
    leads = [blow.lead for blow in moved if not math.isnan(blow.lead)]
    metrics = {
        **false_slips,
        "paper": ending != "dropped" and all(blow.paper for blow in blows[1:]),
        "slide": float(np.mean([blow.slide for blow in moved])) if moved else math.nan,  # mm, mean over blows
        "lead": float(np.mean(leads)) if leads else math.nan,  # ms from the registered slip to the sliding
        "moved": len(moved),  # blows that moved the object
        "soft": len(soft),  # blows that moved nothing
        "false_soft": sum(blow.ending == "false at soft blow" for blow in soft),
    }
    for size, (low, high) in SIZES.items():
        those = [blow for blow in blows if low <= blow.slide < high]
        metrics |= {
            f"blows {size}": len(those),
            f"missed {size}": sum(blow.ending in {"missed", "too late"} for blow in those),
        }
    return Outcome(ending, ending == "registered", metrics)


def _judge_blow(trace: Trace, rule: GripController, start: float, end: float) -> _Blow:
    """Judge the time from a blow until the next one (s).

    A slide between still and moved, or of the passive fingers alone, may be judged either way.
    """
    onsets, rows = trace.onsets(rule), trace.between(start, end)
    onsets = onsets[(onsets >= start) & (onsets < end)]
    sliding = trace.t[rows][trace.fastest[rows] > SLIDING]
    slide, registered = trace.travel(rows), trace.registered(rule)
    still = trace.travel(rows, trace.fastest) < STILL or not len(sliding)
    rest = (float(sliding[-1]) if len(sliding) else start) + RINGING
    answered = slide < MOVED or bool(registered[trace.between(start, min(rest, end))].any())
    back = not registered[trace.between(rest, end)].any()
    lead = 1000 * float(sliding[0] - onsets[0]) if len(onsets) and len(sliding) else math.nan
    if still:
        ending = "false at soft blow" if len(onsets) else "registered"
    elif slide >= MOVED and not len(onsets):
        ending = "missed"
    elif slide >= MOVED and onsets[0] > start + PROMPT:
        ending = "too late"
    else:
        ending = "registered" if back else "not back to static"
    return _Blow(ending, slide, still, lead, paper=answered and back)


def lift(trial: Trial, methods: Sequence[tuple[Detector, GripController]]) -> list[tuple[Trace, Outcome]]:
    """Run one lift trial.

    A delayed gripper closes later, so a rule also waits longer: scores before contact must not count.
    """
    firm, found = trial.hold((), HELD), list[tuple[Trace, Outcome]]()
    delay = round(trial.conditions.delay * s)
    weak = trial.expected_force * float(np.random.default_rng([trial.seed, 8]).uniform(*WEAK))  # N
    for detector, usual in methods:
        rule = replace(usual, force=weak, settle=usual.settle + delay)
        false_slips = firm.scored(detector).false_slips(rule)
        trace = control_trial(trial.grasp(LIFT), detector, rule, trial.conditions, LIFT_END)
        found.append((trace, judge_lift(trace, rule, trial.least_force, false_slips)))
    return found


def judge_lift(trace: Trace, rule: GripController, least: float, false_slips: Mapping[str, int]) -> Outcome:
    """Return the outcome of a lift; its forces are relative to `least`, which just holds the object (N).

    `false_slips` are the metrics of the firm lift. Endings other than ``held``: ``false slip``, registered in
    the firm lift or before anything slid; ``missed``, no slip registered within half a second of sliding;
    ``dropped``; ``not lifted``, hangs too low, still slides or stands on the table.
    """
    lifting = trace.between(LIFT.start, LIFT_END + 1)
    onsets, t = trace.onsets(rule), trace.t[lifting]
    slides = t[trace.fastest[lifting] > SLIDING]
    answers = onsets[onsets >= (slides[0] - EARLY if len(slides) else math.inf)]
    began = [*t[trace.speed[lifting] > SLIDING], *slides]  # s; of the pad, or else of a passive finger
    delay = float(answers[0] - began[0]) if len(answers) else math.nan
    slide: Reals = 1000 * (trace.slide[lifting] - trace.slide[lifting][0])  # (m,) mm
    if held := _held(trace):
        ending = "held"
    elif math.isnan(delay) or delay > LATE:
        ending = "missed"
    else:
        ending = "dropped" if trace.dropped[-1] else "not lifted"
    if false_slips["false_firm"] or len(answers) < len(onsets):
        ending = "false slip"
    force = trace.force[trace.between(LIFT_END - 1, LIFT_END + 1)]
    metrics = {
        **false_slips,
        "paper": held and bool(trace.registered(rule)[lifting].any()),
        "slide": float(slide.max()),  # mm
        "lead": -1000 * delay,  # ms from the first registered slip to the first sliding
        "force": float(force.mean()) / least if held else math.nan,  # mean of the last second
        "peak": float(trace.force.max()) / least,
    }
    return Outcome(ending, ending == "held", metrics)


def _held(trace: Trace) -> bool:
    """Return whether the object hangs in the gripper at the end, and no longer slides."""
    low = float(trace.hand[-1] - trace.height[-1])
    lifted = not trace.dropped[-1] and not trace.on_table[-1] and low < ROOM
    return lifted and bool(np.ptp(trace.slide[trace.between(LIFT_END - 0.5, LIFT_END + 1)]) < RESTS)
