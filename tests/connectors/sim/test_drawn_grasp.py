import numpy as np
import pytest

from connectors.sim.drawn_grasp import RATE, SECONDS, draw_object, simulate_grasp
from connectors.sim.objects import OBJECTS
from connectors.sim.simulated_rig import SLIDING
from operators.batch import Touch, Truth


@pytest.fixture(scope="module")
def grasps() -> list[tuple[Touch, Truth]]:
    return [simulate_grasp(4, number) for number in range(20)]


def test_a_seed_gives_the_same_grasps_and_another_seed_others(grasps: list[tuple[Touch, Truth]]) -> None:
    (again, _), (other, _) = (simulate_grasp(seed, 0) for seed in (4, 5))
    assert (grasps[0][0].counts == again.counts).all()
    assert not np.array_equal(grasps[0][0].counts[:100], other.counts[:100])


def test_some_grasps_slide_and_most_of_the_time_nothing_does(grasps: list[tuple[Touch, Truth]]) -> None:
    slides = [truth.sliding > SLIDING for _, truth in grasps]
    assert 0.2 < np.mean([each.any() for each in slides]) < 1
    assert 0.01 < np.concatenate(slides).mean() < 0.3
    for touch, truth in grasps:
        assert len(touch) == len(truth) <= SECONDS * RATE
        assert not (truth.sliding[:100] > SLIDING).any()  # the gripper is open


def test_objects_have_wider_ranges_than_the_six() -> None:
    random = np.random.default_rng(5)
    drawn = [draw_object(random) for _ in range(300)]
    assert {each.curvature for each in drawn} >= {each.curvature for each in OBJECTS.values()}
    for name in ("mass", "friction", "texture", "stiffness"):
        values = [getattr(each, name) for each in drawn]
        known = [getattr(each, name) for each in OBJECTS.values()]
        assert min(values) < min(known)
        assert max(values) > max(known)
    assert not {(each.mass, each.radius) for each in drawn} & {
        (each.mass, each.radius) for each in OBJECTS.values()
    }
