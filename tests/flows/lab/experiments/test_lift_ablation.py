import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from connectors.sim.grasp_actions import Lift
from flows.lab.experiments.lift_ablation import (
    HARD,
    RATES,
    REPEATS,
    Ablation,
    ablate,
    climb_time,
    crossing,
    delayed,
    fall_time,
    rate_conditions,
    slide_budget,
    slide_budgets,
)
from flows.lab.experiments.lift_trial import LIFT, ROOM
from flows.lab.experiments.study import Method, Trials
from flows.lab.experiments.trial import Conditions

NONE = Method("psd", "none")
Make = Callable[..., Ablation]


def test_success_crosses_a_level_between_two_delays() -> None:
    assert crossing([0, 100, 200], [100, 95, 85]) == 150
    assert crossing([0, 100], [80, 100]) == 0
    assert crossing([0, 100], [100, 90]) == math.inf


def test_conditions_change_the_rate_or_the_delay_only() -> None:
    nominal = Conditions()
    tried = rate_conditions(nominal)
    assert len(tried) == len(RATES) + len(REPEATS)
    assert tried["50 Hz"] == replace(nominal, rate=50.0)
    assert tried["50 Hz, repeated"] == replace(nominal, repeat=2)
    late = delayed(delayed(nominal, 50), 100)
    assert late.gripper.delay == pytest.approx(0.15)
    assert replace(late, gripper=nominal.gripper) == nominal


def test_an_object_breaks_when_the_gripper_climbs_its_room_before_a_firm_grip(
    make_ablation: Make,
) -> None:
    found = make_ablation(firm=0.15)
    assert found.predicted_delay(NONE, "ball") == pytest.approx(300, abs=1)  # 20 mm after 450 ms
    assert found.predicted_delay(NONE, "ball", lost=True) == pytest.approx(380, abs=1)  # 24 mm after 530 ms


def test_compliance_of_the_fingers_reduces_the_room(make_ablation: Make) -> None:
    found = make_ablation(firm=0.15, give=2.0)
    assert found.predicted_delay(NONE, "ball") == pytest.approx(260, abs=1)  # 18 mm after 410 ms
    assert found.predicted_delay(NONE, "ball", lost=True) == pytest.approx(380, abs=1)


def test_a_trial_that_fails_without_delay_tolerates_none_and_one_that_needs_no_control_any(
    make_ablation: Make,
) -> None:
    failed = make_ablation(firm=0.15, ending="too late", lost=True)
    assert failed.predicted_delay(NONE, "ball") == failed.predicted_delay(NONE, "ball", lost=True) == 0
    assert make_ablation(firm=0.0).predicted_delay(NONE, "ball") == math.inf
    assert make_ablation(firm=math.nan).predicted_delay(NONE, "ball") == math.inf


def test_measured_limits_are_interpolated(make_ablation: Make) -> None:
    found = make_ablation(firm=0.15, late="not lifted")
    assert found.breaking_delay(NONE, "ball") == pytest.approx(10)  # from 100 % to 0 within 100 ms
    assert found.loss_delay(NONE, "ball") == math.inf
    assert make_ablation(firm=0.15, late="too late", late_lost=True).loss_delay(
        NONE, "ball"
    ) == pytest.approx(10)
    assert found.first_to_break(NONE) == "ball"


def test_every_condition_is_tried_with_the_same_trials() -> None:
    seen: list[tuple[int, int, str]] = []
    trials = Trials(1, objects=("ball",))
    found = ablate(
        [NONE],
        trials,
        delays=(0, 600),
        jobs=1,
        progress=lambda done, total, label: seen.append((done, total, label)),
    )
    groups = [list(group.values()) for group in (found.delays, found.rates, found.hard)]
    assert [len(group) for group in groups] == [2, len(RATES) + len(REPEATS), len(HARD)]
    assert {results.trials for group in groups for results in group} == {trials}
    assert seen[0][:2] == (0, sum(map(len, groups)))
    assert found.nominal.success(NONE, "ball") == 0
    assert all(outcome.lost for outcome in found.nominal.of(NONE))


@pytest.mark.parametrize("distance", [0.001, 0.01, 0.02, 0.049])
def test_climb_time_inverts_the_motion(distance: float) -> None:
    time = climb_time(LIFT, distance)
    assert LIFT.climbed(np.array([LIFT.instant + time]))[0] == pytest.approx(distance, abs=1e-6)


def test_a_gripper_never_climbs_beyond_its_height() -> None:
    assert climb_time(Lift(2.0, height=0.05), 0.05) == math.inf
    assert climb_time(Lift(2.0, height=0.05), 0.06) == math.inf


def test_a_firmer_grip_falls_later_and_one_that_holds_never() -> None:
    assert fall_time(0.02, 0.2) < fall_time(0.02, 0.8) < fall_time(0.02, 0.99)
    assert fall_time(0.02, 1.0) == math.inf


@pytest.mark.parametrize("name", ["box", "ball"])
def test_without_control_an_object_slides_and_falls_as_computed(name: str) -> None:
    budget = slide_budget(name, 900_000, Conditions())
    assert budget.table_measured == pytest.approx(budget.table, abs=0.03)
    assert budget.air_measured == pytest.approx(budget.air, rel=0.1)
    assert budget.air_measured < budget.table_measured / 3


def test_a_ball_has_a_shorter_reach_than_a_box_and_neither_more_room_than_may_hang() -> None:
    ball, box = (slide_budget(name, 900_005, Conditions()) for name in ("ball", "box"))
    assert ball.reach < box.reach / 3
    assert max(ball.room, box.room) <= ROOM


def test_processes_change_no_budget() -> None:
    trials = Trials(2, 3, ("ball", "box"))
    alone, shared = (slide_budgets(trials, Conditions(), jobs=jobs) for jobs in (1, 2))
    assert repr(alone) == repr(shared)
    assert list(alone) == ["ball", "box"]
    assert len(alone["ball"]) == 2
