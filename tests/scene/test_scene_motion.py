import numpy as np
import pytest

from flows.learn.evaluation.published import SPEEDS, SURFACES, TABLE_3, TABLE_3_ANY
from tests.scene.scene_motion import EFFECTS

STROKES = ("primary", "oblique")
WORSE = EFFECTS[3]  # by 10.6 points in the paper


@pytest.mark.parametrize(
    ("difference", "error", "verdict"),
    [
        (-5.0, 1.0, "reproduced"),
        (-2.0, 1.0, "reproduced"),
        (-1.9, 1.0, "no clear effect"),
        (5.0, 1.0, "reversed"),
        (np.nan, np.nan, "not in the plan"),
    ],
)
def test_a_difference_of_two_errors_has_a_verdict_by_its_sign(
    difference: float, error: float, verdict: str
) -> None:
    assert WORSE.verdict(difference, error) == verdict


def test_the_papers_effects_follow_from_its_table() -> None:
    plane, sphere, *cylinders = TABLE_3_ANY
    slow, fast = ([TABLE_3[kind, speed][-1] for kind in STROKES] for speed in (SPEEDS[0], SPEEDS[2]))
    primary, oblique = ([TABLE_3[kind, speed][-1] for speed in SPEEDS] for kind in STROKES)
    along = [TABLE_3["primary", speed][SURFACES.index("cylinder_y")] for speed in SPEEDS]
    differences = [
        ([plane], [sphere, *cylinders]),
        ([sphere], [plane, *cylinders]),
        (oblique, primary),
        ([TABLE_3["rotation", None][-1]], [*primary, *oblique]),
        (fast, slow),
        (along[:1], along[1:]),
    ]
    found = [np.mean(first) - np.mean(second) for first, second in differences]
    assert found == pytest.approx([effect.paper for effect in EFFECTS], abs=0.051)
