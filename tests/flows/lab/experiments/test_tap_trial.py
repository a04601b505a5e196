from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np
import pytest

from connectors.sim.objects import OBJECTS, named
from flows.lab.experiments.tap_trial import BLOW, LEAST_SLIDE, MOST_SLIDE, TapOutcome, judge_tap, tap
from flows.lab.experiments.trial import Conditions, NullDetector, Trace
from operators import Grip
from operators.batch import Reals

MakeTrace: TypeAlias = Callable[..., Trace]
During: TypeAlias = Callable[..., Reals]

RULE = Grip(settle=0)


def _judge(make_trace: MakeTrace, trace: Trace, soft: Trace | None = None) -> TapOutcome:
    return judge_tap(trace, soft or make_trace(), RULE, "top", 1)


def _blow(make_trace: MakeTrace, during: During, *slip: tuple[float, float]) -> Trace:
    sliding = during((BLOW, BLOW + 0.05), value=0.04)
    return make_trace(speed=sliding, slide=np.cumsum(sliding) / 100, probability=during(*slip))


def test_a_blow_whose_slip_ends_with_the_sliding_is_registered(make_trace: MakeTrace, during: During) -> None:
    outcome = _judge(make_trace, _blow(make_trace, during, (BLOW + 0.02, BLOW + 0.2)))
    assert outcome.success
    assert outcome.delay == pytest.approx(30)
    assert outcome.slide == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("slip", "ending"),
    [
        ((), "missed"),
        (((BLOW + 0.25, BLOW + 0.3),), "too late"),
        (((BLOW - 0.5, BLOW - 0.4), (BLOW, BLOW + 0.1)), "false before"),
        (((BLOW, BLOW + 0.6),), "not back to static"),
        (((BLOW, BLOW + 0.1), (BLOW + 1, BLOW + 1.1)), "not back to static"),
    ],
)
def test_each_failure_has_its_ending(
    make_trace: MakeTrace, during: During, slip: tuple[tuple[float, float], ...], ending: str
) -> None:
    assert _judge(make_trace, _blow(make_trace, during, *slip)).ending == ending


def test_an_object_knocked_out_of_the_gripper_is_dropped(make_trace: MakeTrace, during: During) -> None:
    trace = replace(_blow(make_trace, during, (BLOW, BLOW + 0.1)), dropped=during((5.0, 7.0)) > 0)
    assert _judge(make_trace, trace).ending == "dropped"


def test_false_slips_are_counted_by_phase(make_trace: MakeTrace, during: During) -> None:
    soft = make_trace(probability=during((2.1, 2.2), (4.0, 4.1), (BLOW, BLOW + 0.1)))
    outcome = _judge(make_trace, make_trace(), soft)
    assert (outcome.false_lift, outcome.false_hold, outcome.false_tap) == (1, 1, 1)


@pytest.mark.parametrize(("seed", "name"), list(enumerate(OBJECTS)))
def test_the_blow_moves_every_object_but_not_far(name: str, seed: int) -> None:
    _, outcome = tap(named(name), seed, NullDetector(), Grip(), Conditions())
    assert outcome.ending == "missed"
    assert LEAST_SLIDE <= outcome.slide <= MOST_SLIDE
    assert outcome.side == ("top" if seed % 2 else "side")
