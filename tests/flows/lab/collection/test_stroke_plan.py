import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from connectors.ur.ur_state import Pose, offset_pose
from flows.lab.collection.arm_path import Line, Surface
from flows.lab.collection.plan_file import load_plan
from flows.lab.collection.stroke_plan import CollectionPlan, PlannedPath, StrokeSeries

PLACE: Pose = (0.4, 0.0, 0.1, math.pi, 0.0, 0.0)


def only(plan: CollectionPlan, surface: Surface | None = None, place: Pose = PLACE) -> StrokeSeries:
    (series,) = replace(plan, surfaces=(surface or Surface(),)).series(place)
    return series


STROKES = CollectionPlan(speeds=(0.1,), repeats=1, rotations=0)


def test_the_papers_plan_has_all_surfaces_speeds_directions_and_rotations() -> None:
    surfaces = (Surface(), Surface("sphere", pose=offset_pose(PLACE, (0.2, 0, 0))))
    sessions = replace(load_plan("paper"), surfaces=surfaces, seed=3).series(PLACE)
    counted = Counter((each.surface.shape, each.speed) for each in sessions)
    assert counted == {
        (surface, speed): 5 if speed is None else 9
        for surface in ("plane", "sphere")
        for speed in (0.05, 0.075, 0.1, None)
    }
    for session in sessions:
        assert len(session.strokes) == 16
        directions = Counter(round(math.degrees(stroke.direction), 9) for stroke in session.strokes)
        expected = {0.0: 16} if session.speed is None else dict.fromkeys(np.arange(8) * 45.0, 2)
        assert directions == expected
    assert len({each.name for each in sessions}) == len(sessions)
    assert set(Counter(each.split for each in sessions)) == {"train", "validation", "test"}


@pytest.mark.parametrize("place", [PLACE, (0.1, 0.2, 0.3, 0.5, -1.0, 0.7)])
def test_a_stroke_slides_through_the_middle_pressed_by_its_depth(place: Pose) -> None:
    for stroke in only(STROKES, place=place).strokes:
        down = stroke.approach[-1].poses[-1]
        (slide,) = [step for step in stroke.contact if isinstance(step, Line)]
        assert slide.speed == 0.1
        assert math.dist(down[:3], slide.poses[0][:3]) == pytest.approx(0.06)
        middle = [(a + b) / 2 for a, b in zip(down[:3], slide.poses[0][:3], strict=True)]
        np.testing.assert_allclose(middle, offset_pose(place, (0, 0, STROKES.path.depth))[:3], atol=1e-12)
        forward = offset_pose(
            (0, 0, 0, *place[3:]), (math.cos(stroke.direction), math.sin(stroke.direction), 0)
        )
        np.testing.assert_allclose(
            np.subtract(slide.poses[0][:3], down[:3]), 0.06 * np.array(forward[:3]), atol=1e-12
        )


def test_the_bounds_and_the_duration_of_a_plan_are_those_of_its_path() -> None:
    reach = PlannedPath.of(STROKES, PLACE, PLACE)
    np.testing.assert_allclose(reach.low, (0.37, -0.03, 0.1 - STROKES.path.depth), atol=1e-12)
    np.testing.assert_allclose(reach.high, (0.43, 0.03, 0.1 + STROKES.path.clearance), atol=1e-12)
    contact = 16 * (2 * STROKES.path.rest + 0.6 + 0.1 / 0.5)
    vertical = 16 * 2 * (0.0115 / 0.02 + 0.02 / 0.5)
    air = reach.seconds - STROKES.path.baseline - contact - vertical
    assert 0 < air < 16 * (0.06 / 0.1 + 0.1 / 0.5)


def test_the_seed_determines_the_order_of_directions() -> None:
    orders = [
        [stroke.direction for stroke in replace(STROKES, seed=seed).series(PLACE)[0].strokes]
        for seed in (0, 0, 1)
    ]
    assert orders[0] == orders[1] != orders[2]
