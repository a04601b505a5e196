import math

import numpy as np
import pytest

from connectors.sim.lift_motion import Lift
from flows.lab.experiments.lifting import LAGS, LIFT
from flows.lab.experiments.slide_budget import budget, budgets, climbing, falling
from flows.lab.experiments.trial_setting import Conditions


@pytest.mark.parametrize("way", [0.001, 0.01, 0.02, 0.049])
def test_a_hand_has_climbed_a_way_when_it_is_said_to(way: float) -> None:
    time = climbing(LIFT, way)
    assert LIFT.climbed(np.array([LIFT.instant + time]))[0] == pytest.approx(way, abs=1e-6)


def test_a_hand_never_climbs_further_than_it_goes() -> None:
    assert climbing(Lift(2.0, height=0.05), 0.05) == math.inf
    assert climbing(Lift(2.0, height=0.05), 0.06) == math.inf


def test_a_firmer_grip_falls_later_and_one_that_holds_never() -> None:
    assert falling(0.02, 0.2) < falling(0.02, 0.8) < falling(0.02, 0.99)
    assert falling(0.02, 1.0) == math.inf


@pytest.mark.parametrize("thing", ["box", "ball"])
def test_without_control_an_object_slides_as_the_hand_climbs_and_falls_in_the_air_as_friction_leaves(
    thing: str,
) -> None:
    found = budget(thing, 900_000, Conditions())
    assert found.climbed == pytest.approx(found.climbs, abs=0.03)
    assert found.fell == pytest.approx(found.falls, rel=0.1)
    assert found.fell < found.climbed / 3


def test_a_ball_leaves_less_way_than_a_box_and_both_count_as_held_no_further_than_they_may_hang() -> None:
    ball, box = (budget(thing, 900_005, Conditions()) for thing in ("ball", "box"))
    assert ball.left < box.left / 3
    assert max(ball.room, box.room) <= LAGS


def test_processes_change_no_budget() -> None:
    seeds = range(3, 5)
    alone, shared = (budgets(["ball", "box"], seeds, Conditions(), jobs=jobs) for jobs in (1, 2))
    assert repr(alone) == repr(shared)
    assert list(alone) == ["ball", "box"]
    assert len(alone["ball"]) == 2
