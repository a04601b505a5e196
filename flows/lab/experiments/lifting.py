"""The paper's object lift: gripped too weakly, lifted, and caught by more force, or not."""

import math
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

import numpy as np

from connectors.sim.lift_motion import Lift
from connectors.sim.objects import Object
from flows.lab.experiments.decisions import registered
from flows.lab.experiments.trial import BASELINE, By, Trace, run
from flows.lab.experiments.trial_setting import SLIDES, Conditions, Setting
from operators.batch import s
from operators.grip import GripController

LIFT: Final = Lift(2.5)  # the hand closes at 1 s; 50 mm at 50 mm/s, assumed: the paper says nothing
END: Final = 6.0  # s; the hand has come to rest 2.3 s before
WEAK: Final = (0.4, 0.8)  # of the least force that is expected to hold, at contact; assumed
LAGS: Final = 0.02  # m, that an object which is held may hang lower than it was gripped
RESTS: Final = 0.0005  # m, that it may slide in the last half second
LATE: Final = 0.5  # s after an object began to slide, from when on its slip counts as missed
EARLY: Final = 0.02  # s, that a registered slip may come before the sliding that it belongs to

Ending: TypeAlias = Literal["held", "missed", "too late", "dropped after catch", "given up", "left behind"]


@dataclass(frozen=True, slots=True)
class Lifting:
    """What one lift came to.

    Of those that are not held: ``missed`` if no slip was registered within half a second of sliding;
    ``dropped after catch`` if the hand once gripped with what holds; ``given up`` if the controller let go;
    ``left behind`` if it hangs low, slides on or stands on the table still; else ``too late``.
    """

    ending: Ending
    slide: float  # mm
    delay: float  # ms from the first sliding to the first registered slip; NaN: none
    ratio: float  # mean force of the last second over the least that holds; NaN: not held
    peak: float  # highest force over the least that holds
    false: int  # slips registered before anything slid
    firm: float = math.nan  # s from the hand's start upwards until it grips with what holds; NaN: never
    lost: bool = False  # out of the fingers
    give: float = 0.0  # mm that it hangs lower in the end than it slid: fingers and rubber give

    @property
    def success(self) -> bool:
        """Whether it was lifted and held."""
        return self.ending == "held"


def lift(held: Object, seed: int, by: By, conditions: Conditions) -> tuple[Trace, Lifting]:
    """One lift; the rule begins with the weak force that is drawn.

    A hand that hears late closes late: what is felt until then is its touch, and decides nothing.
    """
    detector, grip = by
    setting = Setting.drawn(held, seed, conditions.nature)
    rule = replace(
        grip, force=weak(setting, conditions), settle=grip.settle + round(conditions.hand.delay * s)
    )
    trace = run(setting.grasp(raised(conditions)), (detector, rule), conditions, END)
    return trace, judged(trace, rule, setting.least)


def weak(setting: Setting, conditions: Conditions) -> float:
    """The force (N) that the hand of a trial begins with."""
    share = float(np.random.default_rng([setting.seed, 8]).uniform(*WEAK))
    return setting.expected * share * conditions.weak


def raised(conditions: Conditions) -> Lift:
    """The hand's way up."""
    pace = conditions.pace
    return replace(LIFT, speed=pace * LIFT.speed, acceleration=pace * LIFT.acceleration)


def judged(trace: Trace, grip: GripController, least: float) -> Lifting:
    """What a lift came to; `least` is the least force that holds (N)."""
    lifting = trace.between(LIFT.instant, END + 1)
    slides = trace.t[lifting][trace.speed[lifting] > SLIDES]
    began = float(slides[0]) if len(slides) else math.inf
    felt = registered(trace, grip.threshold, grip.consecutive)
    felt = felt[felt > BASELINE + grip.settle / s]
    answers = felt[felt >= began - EARLY]
    delay = float(answers[0]) - began if len(answers) else math.nan
    slid = 1000 * (trace.slide[lifting] - trace.slide[lifting][0])
    ending = _ending(trace, grip, least, delay)
    force = trace.force[trace.between(END - 1, END + 1)]
    firm = trace.t[lifting][trace.force[lifting] >= least]
    return Lifting(
        ending,
        float(slid.max()),
        1000 * delay,
        float(force.mean()) / least if ending == "held" else math.nan,
        float(trace.force.max()) / least,
        int((felt < began - EARLY).sum()),
        float(firm[0]) - LIFT.instant if len(firm) else math.nan,
        bool(trace.dropped[-1]),
        1000 * float(trace.hand[-1] - trace.height[-1]) - float(slid[-1]),
    )


def _ending(trace: Trace, grip: GripController, least: float, delay: float) -> Ending:
    last = trace.between(END - 0.5, END + 1)
    dropped = bool(trace.dropped[-1])
    lags = float(trace.hand[-1] - trace.height[-1])
    if not dropped and not trace.on_table[-1] and lags < LAGS and np.ptp(trace.slide[last]) < RESTS:
        return "held"
    if trace.asked[-1] <= grip.least:
        return "given up"
    if math.isnan(delay) or delay > LATE:
        return "missed"
    gripped = trace.force[~trace.dropped].max() >= least
    if not dropped:
        return "left behind"
    return "dropped after catch" if gripped else "too late"
