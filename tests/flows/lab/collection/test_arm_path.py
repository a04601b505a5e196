import math

import numpy as np
import pytest

from connectors.ur.ur_state import Pose, offset_pose
from flows.lab.collection.arm_path import Line, Turn
from operators.rotation import rotation_difference

START: Pose = (0.4, 0.1, 0.2, math.pi, 0.0, 0.0)  # looks down


def test_a_line_has_a_trapezoidal_speed_profile() -> None:
    assert Line(((0.5, 0.1, 0.2, math.pi, 0, 0),), 0.1, 0.5).seconds(START) == pytest.approx(1.0 + 0.2)


def test_the_duration_of_a_pure_rotation_follows_from_its_angle() -> None:
    turned = offset_pose(START, yaw=0.3)
    assert Line((turned,), 0.1, 0.5).seconds(START) == pytest.approx(0.3 / 0.1 + 0.2)


@pytest.mark.parametrize(("time", "angle", "seconds"), [(2.0, 2.0, 3.0), (0.5, 0.25, 1.0)])
def test_the_angle_of_a_turn_includes_its_ramps(time: float, angle: float, seconds: float) -> None:
    turn = Turn(1.0, time, 1.0)
    end = turn.end(START)
    assert math.hypot(*rotation_difference(START[3:], end[3:])) == pytest.approx(angle)
    assert turn.seconds(START) == pytest.approx(seconds)
    assert end[:3] == START[:3]


@pytest.mark.parametrize("pose", [START, (0.1, 0.2, 0.3, 0.5, -1.0, 0.7)])
def test_an_offset_is_in_the_frame_of_the_pose(pose: Pose) -> None:
    there = offset_pose(offset_pose(pose, (0.01, -0.02, 0.03)), (-0.01, 0.02, -0.03))
    np.testing.assert_allclose(there, pose, atol=1e-12)
    assert math.dist(pose[:3], offset_pose(pose, (0.01, -0.02, 0.03))[:3]) == pytest.approx(
        0.0374166, abs=1e-6
    )
