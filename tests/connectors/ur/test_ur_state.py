import math
from math import nan

import pytest

from connectors.ur.ur_state import ArmState, Bounds

BOUNDS = Bounds((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), force=20.0)
POSE = (0.5, 0.5, 0.5, math.pi, 0.0, 0.0)
REST = (0.0,) * 6


@pytest.mark.parametrize(
    ("state", "why"),
    [
        (ArmState(POSE, REST, force=(19.0, 0.0, 5.0)), ""),
        (ArmState(POSE, REST, force=(nan, nan, nan)), ""),  # unknown
        (ArmState(POSE, REST, safety_mode=2), ""),  # reduced mode
        (ArmState((1.001, 0.5, 0.5, 0, 0, 0), REST), "at x 1.0010 m it is outside its workspace"),
        (ArmState((0.5, -0.001, 0.5, 0, 0, 0), REST), "at y -0.0010 m it is outside its workspace"),
        (ArmState((0.5, 0.5, nan, 0, 0, 0), REST), "at z nan m it is outside its workspace"),
        (ArmState(POSE, REST, force=(0.0, 12.0, -16.1)), "a force of 20.1 N, more than 20 N"),
        (ArmState(POSE, REST, safety_mode=3), "protective stop"),
        (ArmState(POSE, REST, safety_mode=7), "emergency stop"),
        (ArmState(POSE, REST, safety_mode=99), "unknown safety mode"),
        (ArmState(POSE, REST, robot_mode=5), "the arm is not running (robot mode 5)"),
    ],
)
def test_an_arm_outside_its_bounds_has_a_reason_to_be_stopped(state: ArmState, why: str) -> None:
    assert BOUNDS.violation(state) == why


def test_an_arm_stands_at_a_pose_within_tolerances() -> None:
    assert ArmState(POSE, REST).stands_at((0.5004, 0.5, 0.5, math.pi, 0.0, 0.0))
    assert not ArmState(POSE, REST).stands_at((0.5006, 0.5, 0.5, math.pi, 0.0, 0.0))
    assert not ArmState(POSE, REST).stands_at((0.5, 0.5, 0.5, math.pi, 0.02, 0.0))
    assert not ArmState(POSE, (0.002, 0, 0, 0, 0, 0)).stands_at(POSE)
    assert ArmState(POSE, REST).stands_at((0.5, 0.5, 0.5, -math.pi, 0.0, 0.0))  # the same rotation
