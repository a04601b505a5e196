from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import pytest

from connectors.sim.objects import named
from flows.lab.experiments import lifting
from flows.lab.experiments.lifting import LIFT, lift
from flows.lab.experiments.tapping import Nothing
from flows.lab.experiments.trial import Trace
from flows.lab.experiments.trial_setting import Conditions
from operators import Grip
from operators.batch import Reals

Make: TypeAlias = Callable[..., Trace]
During: TypeAlias = Callable[..., Reals]

UP = {"hand": np.full(600, 0.05), "height": np.full(600, 0.048)}
DOWN = {"hand": np.full(600, 0.05), "height": np.zeros(600), "on_table": np.ones(600, np.bool_)}
GRIP = Grip(settle=0)


def _judged(trace: Trace, least: float = 0.9) -> lifting.Lifting:
    return lifting.judged(trace, GRIP, least)


def test_what_is_up_and_rests_is_held(made: Make, during: During) -> None:
    outcome = _judged(made(**UP, slide=during((2.6, 7.0), value=0.004)))
    assert outcome.success
    assert outcome.slide == pytest.approx(4.0)
    assert outcome.ratio == pytest.approx(1 / 0.9)


def test_what_still_slides_in_the_end_is_not_held(made: Make, during: During) -> None:
    sliding = during((2.6, 7.0), value=0.01)
    felt = during((2.6, 7.0))
    outcome = _judged(made(**UP, speed=sliding, slide=np.cumsum(sliding) / 100, probability=felt))
    assert outcome.ending == "left behind"


def test_a_slip_that_nobody_registers_is_missed_and_so_is_one_that_is_registered_after_half_a_second(
    made: Make,
    during: During,
) -> None:
    sliding = during((2.6, 4.0), value=0.02)
    assert _judged(made(**DOWN, speed=sliding)).ending == "missed"
    late = _judged(made(**DOWN, speed=sliding, probability=during((3.2, 3.5))))
    assert late.ending == "missed"
    assert late.delay == pytest.approx(610)


def test_what_is_dropped_was_caught_too_late_or_held_once(made: Make, during: During) -> None:
    lost = {
        **DOWN,
        "speed": during((2.6, 3.0), value=0.02),
        "dropped": during((3.0, 7.0)) > 0,
        "probability": during((2.6, 3.0)),
    }
    assert _judged(made(**lost), least=1.1).ending == "too late"
    assert _judged(made(**lost), least=0.9).ending == "dropped after catch"


def test_what_the_controller_lets_go_of_is_given_up(made: Make, during: During) -> None:
    sliding = during((2.6, 4.0), value=0.02)
    trace = made(**DOWN, speed=sliding, probability=during((2.6, 4.0)), asked=np.zeros(600))
    assert _judged(trace).ending == "given up"


def test_a_slip_registered_before_anything_slides_is_false(made: Make, during: During) -> None:
    trace = made(**UP, probability=during((2.0, 2.1), (2.6, 2.8)), speed=during((2.6, 2.8)))
    assert _judged(trace).false == 1
    assert _judged(trace).delay == pytest.approx(10)


def test_without_control_what_is_gripped_too_weakly_is_left_behind_or_lost() -> None:
    trace, outcome = lift(named("ball"), 1, (Nothing(), Grip()), Conditions())
    assert outcome.ending == "missed"
    assert trace.force.max() < outcome.peak * 2
    assert outcome.peak < 1
    assert trace.hand[-1] == pytest.approx(LIFT.height, abs=1e-4)
    assert outcome.slide > 10


def test_the_same_trial_gives_the_same_trace() -> None:
    first, second = (lift(named("box"), 2, (Nothing(), Grip()), Conditions())[0] for _ in range(2))
    assert (first.counts == second.counts).all()
    assert (first.slide == second.slide).all()
