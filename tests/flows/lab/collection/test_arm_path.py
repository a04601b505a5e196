import math

import numpy as np
import pytest

from connectors.ur.ur_state import Pose, offset_pose
from flows.lab.collection.arm_path import STEEPEST, Line, Surface, Turn
from operators import ParameterError

START: Pose = (0.4, 0.1, 0.2, math.pi, 0.0, 0.0)  # looks down


@pytest.mark.parametrize(("yaw", "seconds"), [(0.0, 0.1 / 0.1 + 0.2), (0.3, 0.3 / 0.1 + 0.2)])
def test_a_line_has_a_trapezoidal_speed_profile_of_its_way_or_angle(yaw: float, seconds: float) -> None:
    end = offset_pose(START, (0.0, 0.0, 0.0) if yaw else (0.1, 0.0, 0.0), yaw=yaw)
    assert Line((end,), 0.1, 0.5).seconds(START) == pytest.approx(seconds)


@pytest.mark.parametrize(("time", "angle", "seconds"), [(2.0, 2.0, 3.0), (0.5, 0.25, 1.0)])
def test_the_angle_of_a_turn_includes_its_ramps(time: float, angle: float, seconds: float) -> None:
    turn = Turn(1.0, time, 1.0)
    assert (turn.angle, turn.seconds) == pytest.approx((angle, seconds))


def test_a_path_is_straight_along_a_cylinder_and_bent_across() -> None:
    surface = Surface("cylinder_x")
    assert surface.waypoints(0.03, 0.0) == [1.0]
    across = surface.waypoints(0.0, -0.03)
    assert across[-1] == 1.0
    assert min(across) > -1.0
    assert np.diff(across).max() * 0.03 <= 0.002 + 1e-12


def test_too_steep_a_path_is_refused_with_the_least_radius() -> None:
    Surface("sphere", 0.03 / math.sin(STEEPEST) * 1.001).waypoints(0.03, 0.0)
    with pytest.raises(ParameterError, match=r"0\.0424 m for strokes of 0\.0300 m"):
        Surface("sphere", 0.04).waypoints(0.03, 0.0)
    with pytest.raises(ParameterError, match=r"0\.0300 m for strokes of 0\.0300 m"):
        Surface("cylinder_y", 0.02).waypoints(0.03 * math.sqrt(0.5), 0.03 * math.sqrt(0.5))
    Surface("cylinder_x", 0.02).waypoints(0.03, 0.0)  # along its axis
