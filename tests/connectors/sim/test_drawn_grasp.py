import numpy as np
import pytest

from connectors.sim.drawn_grasp import RATE, SECONDS, simulate_grasp
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
