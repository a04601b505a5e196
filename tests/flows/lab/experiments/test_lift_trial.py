import math

import numpy as np
import pytest

from flows.lab.experiments.study import StepThreshold
from flows.lab.experiments.tap_and_lift import LIFT, judge_lift, lift
from flows.lab.experiments.trial import BASELINE, Conditions, Outcome, Trace, Trial
from operators import Grip
from storage import load_detector
from tests.flows.lab.experiments.traces import during, make_trace

UP = {"hand": np.full(700, 0.05), "height": np.full(700, 0.048)}
DOWN = {"hand": np.full(700, 0.05), "height": np.zeros(700), "on_table": np.ones(700, np.bool_)}
NEVER = StepThreshold(math.inf)  # never reports slip


def _judge(trace: Trace, least: float = 0.9) -> Outcome:
    return judge_lift(trace, Grip(settle=0), least, {"false_firm": 0})


def test_an_object_that_is_up_and_rests_is_held() -> None:
    outcome = _judge(make_trace(**UP, slide=during((2.6, 7.0), value=0.004)))
    assert outcome.success
    assert outcome.metrics["slide"] == pytest.approx(4.0)
    assert outcome.metrics["force"] == pytest.approx(1 / 0.9)


def test_the_papers_definition_asks_for_a_registered_slip_and_a_held_object() -> None:
    early = make_trace(**UP, probability=during((2.6, 2.8)), speed=during((2.9, 3.0)))
    assert (_judge(early).ending, _judge(early).metrics["paper"]) == ("false slip", True)
    assert not _judge(make_trace(**UP)).metrics["paper"]
    assert not _judge(make_trace(**DOWN, probability=during((2.6, 2.8)))).metrics["paper"]


def test_an_object_that_still_slides_at_the_end_is_not_lifted() -> None:
    sliding, slip = during((2.6, 7.0), value=0.01), during((2.6, 7.0))
    outcome = _judge(make_trace(**UP, speed=sliding, slide=np.cumsum(sliding) / 100, probability=slip))
    assert outcome.ending == "not lifted"


def test_a_slip_that_is_not_registered_within_half_a_second_is_missed() -> None:
    sliding = during((2.6, 4.0), value=0.02)
    assert _judge(make_trace(**DOWN, speed=sliding)).ending == "missed"
    late = _judge(make_trace(**DOWN, speed=sliding, probability=during((3.2, 3.5))))
    assert late.ending == "missed"
    assert late.metrics["lead"] == pytest.approx(-610)


def test_a_registered_slip_may_still_end_with_a_dropped_object() -> None:
    slip, dropped = during((2.6, 3.0)), during((3.0, 7.0)) > 0
    lost = make_trace(**DOWN, speed=0.02 * slip, probability=slip, dropped=dropped)
    assert _judge(lost).ending == "dropped"


def test_a_false_slip_fails_a_held_object() -> None:
    trace = make_trace(**UP, probability=during((2.0, 2.1), (2.6, 2.8)), speed=during((2.6, 2.8)))
    assert _judge(trace).ending == "false slip"  # before anything slid
    assert _judge(trace).metrics["lead"] == pytest.approx(-10)
    clean = make_trace(**UP, probability=during((2.6, 2.8)), speed=during((2.6, 2.8)))
    assert _judge(clean).success
    assert judge_lift(clean, Grip(settle=0), 0.9, {"false_firm": 1}).ending == "false slip"


def test_without_control_a_weak_grip_loses_the_object() -> None:
    [(trace, outcome)] = lift(Trial.draw("ball", 1, Conditions()), [(NEVER, Grip())])
    assert outcome.ending == "missed"
    assert trace.force.max() < outcome.metrics["peak"] * 2
    assert outcome.metrics["peak"] < 1
    assert trace.hand[-1] == pytest.approx(LIFT.distance, abs=1e-4)
    assert outcome.metrics["slide"] > 10


@pytest.mark.parametrize("rate", [10.0, 25.0])
def test_the_gripper_has_closed_before_the_lift_at_every_rate(rate: float) -> None:
    [(trace, _)] = lift(Trial.draw("ball", 1, Conditions(rate=rate)), [(load_detector("tcn"), Grip())])
    assert trace.force[trace.between(BASELINE + 0.3, LIFT.start)].min() > 0
    assert np.diff(trace.t[trace.between(BASELINE, 6)]) == pytest.approx(1 / rate)
