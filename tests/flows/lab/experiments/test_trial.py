import numpy as np
import pytest

from connectors.sim.objects import OBJECTS
from flows.lab.experiments.trial import (
    FINGERTIP,
    FIRM,
    FIRM_LIFT,
    HELD,
    PHASES,
    RANDOM,
    SPAN,
    Conditions,
    Trial,
    control_trial,
)
from operators import Grip, StepGrip
from operators.detectors import Psd
from tests.flows.lab.experiments.traces import during, make_trace

BALL = OBJECTS["ball"]


def test_random_objects_differ_from_trial_to_trial_and_can_be_held_firmly() -> None:
    drawn = [Trial.draw(RANDOM, seed, Conditions()) for seed in range(20)]
    assert len({trial.held.mass for trial in drawn}) == len({trial.fingertip.lever for trial in drawn}) == 20
    assert max(trial.least_force for trial in drawn) * FIRM[0] < SPAN
    assert Trial.draw(RANDOM, 3, Conditions()) == drawn[3]


def test_the_expected_force_assumes_nominal_friction_and_mass() -> None:
    nominal = Trial.draw("ball", 3, Conditions())
    heavy = Trial.draw("ball", 3, Conditions(friction=0.5, mass=2.0))
    assert heavy.least_force == pytest.approx(4 * nominal.least_force)
    assert heavy.expected_force == pytest.approx(nominal.expected_force)
    assert nominal.expected_force == pytest.approx(nominal.least_force)


def test_conditions_change_the_object_and_the_pad_but_not_the_rest() -> None:
    nominal, changed = (Trial.draw("ball", 3, one) for one in (Conditions(), Conditions(stiffness=2, tilt=3)))
    assert changed.held.stiffness == 2 * BALL.stiffness
    assert changed.fingertip.tilt_stiffness == 3 * FINGERTIP.tilt_stiffness
    assert (changed.position, changed.firm, changed.held.mass) == (
        nominal.position,
        nominal.firm,
        nominal.held.mass,
    )
    assert FIRM[0] <= nominal.firm <= FIRM[1]


@pytest.mark.parametrize("rate", [25.0, 100.0])
def test_scores_added_to_a_trace_are_those_of_the_closed_loop(rate: float) -> None:
    trial = Trial.draw("ball", 2, Conditions(rate=rate))
    added = trial.hold((), 3.0).scored(Psd())
    constant = StepGrip(force=trial.firm * trial.least_force, step=1e-12)
    live = control_trial(trial.grasp(FIRM_LIFT), Psd(), constant, trial.conditions, 3.0)
    known = ~np.isnan(live.probability)
    assert known.any()
    assert (added.probability[known] == live.probability[known]).all()


def test_a_slip_registered_in_a_firm_lift_is_false_unless_a_finger_slipped_just_before() -> None:
    rule, seen = Grip(settle=0), during((2.0, 2.1), (2.2, 2.3), (3.5, 3.6))
    none = {"false_firm": 0, **{f"false {phase}": 0 for phase in PHASES}}
    all_false = {**none, "false_firm": 1, "false load transfer": 2, "false holding": 1}
    assert make_trace(probability=seen).false_slips(rule) == all_false
    passive = make_trace(probability=seen, fastest=during((1.9, 2.0), value=0.02))
    assert passive.false_slips(rule) == {**all_false, "false load transfer": 1}
    slow = make_trace(probability=seen, speed=during((1.9, 2.0), value=0.002))
    assert slow.false_slips(rule) == all_false
    assert make_trace(probability=during((0.5, 0.6), (HELD, HELD + 0.1))).false_slips(rule) == none


def test_a_slip_is_registered_after_enough_consecutive_scores() -> None:
    probability = np.zeros(700)
    probability[200:208] = [0.9, 0.9, 0.9, 0.1, 0.9, np.nan, 0.9, 0.9]
    trace = make_trace(probability=probability)
    assert np.flatnonzero(trace.registered(Grip(threshold=0.5, consecutive=2))).tolist() == [201, 202, 207]
    one = trace.registered(Grip(threshold=0.5, consecutive=1))
    assert np.flatnonzero(one).tolist() == [200, 201, 202, 204, 206, 207]
