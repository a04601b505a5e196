from math import nan

import numpy as np
import pytest

from connectors.sim.paper_plan import PaperPlan
from connectors.sim.scene import Scene
from connectors.sim.stress_profiles import FIELDS, stressed
from flows.learn.stress.stress_fields import GOALS, GRIDS, Grid, breaking_point, plan_of


def test_every_field_has_a_grid() -> None:
    assert GRIDS.keys() == FIELDS.keys()


@pytest.mark.parametrize("field", GRIDS)
def test_a_grid_begins_at_nominal_and_each_side_goes_on_from_there(field: str) -> None:
    grid = GRIDS[field]
    assert grid.values[0] == FIELDS[field].nominal
    assert sum(len(side) - 1 for side in grid.sides.values()) == len(grid.values) - 1
    for side in grid.sides.values():
        distances = [abs(value - grid.values[0]) for value in side]
        assert distances == sorted(set(distances)), "ever harder"
        assert len(side) > 2


@pytest.mark.parametrize("field", GRIDS)
def test_every_value_is_one_that_the_field_can_have(field: str) -> None:
    for value in GRIDS[field].values[1:]:
        assert stressed(Scene(), field, value) != Scene()


def test_the_goals_are_on_the_grids() -> None:
    for goal in GOALS:
        assert goal.value in GRIDS[goal.field].values, goal.text


def test_slip_speed_is_one_speed_and_no_rotation() -> None:
    plan = plan_of("slip_speed", PaperPlan(repeats=1))
    strokes = [
        move
        for scene in plan.scenes(0)
        for move in stressed(scene, "slip_speed", 0.2).plan.moves(np.random.default_rng(0))
        if move.speed
    ]
    assert {move.motion for move in strokes} == {"translation"}
    assert {round(move.speed, 6) for move in strokes} == {0.01}
    assert GRIDS["slip_speed"].show(0.2) == "10 mm/s"
    assert plan_of("noise", PaperPlan(repeats=1)) == PaperPlan(repeats=1)


@pytest.mark.parametrize(
    ("scores", "expected"),
    [
        ([90, 85, 75, 60], 1.5),  # 80 lies half way
        ([90, 80, 75, 60], 1),
        ([90, 89, 88, 81], None),
        ([90, 95, 70, 95], 1.6),  # the first time counts
        ([90, 85, nan, 85], 2),
        ([50, 50, 50, 50], None),
        ([90, 60, 60, 60], 1 / 3),
    ],
)
def test_a_breaking_point_is_interpolated(scores: list[float], expected: float | None) -> None:
    assert breaking_point([0, 1, 2, 3], scores) == (None if expected is None else pytest.approx(expected))


def test_values_may_fall_towards_what_is_broken() -> None:
    assert breaking_point([1, 0.5, 0.25], [90, 85, 75]) == pytest.approx(0.375)


def test_a_grid_of_two_sides_begins_each_at_nominal() -> None:
    assert Grid((1, 2, 4, 0.5), "any").sides == {"up": (1, 2, 4), "down": (1, 0.5)}
    assert Grid((1, 0.5), "any").sides == {"down": (1, 0.5)}
