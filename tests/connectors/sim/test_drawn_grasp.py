import numpy as np

from connectors.sim.drawn_grasp import RATE, SECONDS, simulate_grasp
from connectors.sim.simulated_rig import SLIDING


def test_some_grasps_slide_and_most_of_the_time_nothing_does() -> None:
    grasps = [simulate_grasp(4, number) for number in range(20)]
    slides = [truth.sliding > SLIDING for _, truth in grasps]
    assert 0.2 < np.mean([each.any() for each in slides]) < 1
    assert 0.01 < np.concatenate(slides).mean() < 0.3
    for touch, truth in grasps:
        assert len(touch) == len(truth) <= SECONDS * RATE
        assert not (truth.sliding[:100] > SLIDING).any()  # the gripper is open
