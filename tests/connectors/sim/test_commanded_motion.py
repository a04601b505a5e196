from math import nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from connectors.sim.arm_motion import in_base
from connectors.sim.commanded_motion import CommandedArm
from connectors.sim.scene import commanded_scene
from operators.batch import Commands, Reals, s

ORIGIN = 1_700_000_000 * s
LEAVE = [nan] * 6
TIMES = np.arange(0, 2, 1e-3)


def commands(*rows: tuple[float, float, list[float]]) -> Commands:
    """Time (s since the run began), force (N), velocity (m/s, rad/s) of each."""
    time, force, velocity = zip(*rows, strict=True)
    stamps = ORIGIN + np.round(np.array(time) * s).astype(np.int64)
    return Commands(stamps, np.array(force, float), np.array(velocity, float)).check()


def commanded(*rows: tuple[float, float, list[float]]) -> CommandedArm:
    arm = CommandedArm(commanded_scene(), ORIGIN)
    if rows:
        arm.add(commands(*rows))
    return arm


def test_nothing_moves_until_it_is_commanded() -> None:
    drive, pose = commanded().at(TIMES)
    assert not drive.any()
    assert not pose.any()


def test_a_commanded_force_is_approached_at_50_n_per_s() -> None:
    drive, _ = commanded((0.5, 15.0, LEAVE), (1.5, 0.5, LEAVE)).at(TIMES)
    found = drive[[500, 600, 700, 800, 1500, 1600, 1900], 3]
    assert found == pytest.approx([0.0, 5.0, 10.0, 15.0, 15.0, 10.0, 0.5])
    assert commanded((0.0, -3.0, LEAVE)).at(TIMES)[0][-1, 3] == 0.0


def test_a_commanded_velocity_is_in_the_base_frame_from_its_time_on() -> None:
    drive, pose = commanded((0.5, nan, [0.06, 0.08, 0, 0, 0, 0])).at(TIMES)
    assert not drive[:501].any()
    assert drive[501, 0] > 0
    assert drive[-1, :3] == pytest.approx([0.06, -0.08, 0])  # the fingertip faces down
    assert in_base(drive, pose)[0][-1] == pytest.approx([0.06, 0.08, 0, 0, 0, 0])


def test_pose_and_frame_stay_true_to_an_arm_that_translates_and_turns() -> None:
    given = [0.05, -0.02, 0.0, 0.0, 0.0, 0.8]
    drive, local = commanded((0.3, nan, given), (1.2, nan, [0.0] * 6)).at(TIMES)
    velocity, pose = in_base(drive, local)
    np.testing.assert_allclose(velocity[500:1200], np.tile(given, (700, 1)), atol=1e-12)
    steps = np.diff(pose[:, :3], axis=0)
    np.testing.assert_allclose(steps, (velocity[1:] + velocity[:-1])[:, :3] / 2 * 1e-3, atol=1e-7)
    turned = Rotation.from_rotvec(pose[-1, 3:]) * Rotation.from_rotvec(pose[0, 3:]).inv()
    assert turned.as_rotvec() == pytest.approx([0, 0, 0.8 * 0.9])
    seen = Rotation.from_rotvec(pose[:, 3:]).apply(velocity[:, :3], inverse=True)
    np.testing.assert_allclose(seen[:, :2], drive[:, :2], atol=1e-12)


def test_a_command_of_one_quantity_leaves_the_other_as_it_is() -> None:
    push, turn = (0.40, 9.0, LEAVE), (0.5, nan, [0.1, 0, 0, 0, 0, 1.0])
    both, moved = commanded(push, turn, (0.55, 2.0, LEAVE)).at(TIMES), commanded(turn).at(TIMES)
    np.testing.assert_allclose(both[0][:, :3], moved[0][:, :3], atol=1e-12)
    np.testing.assert_allclose(both[1], moved[1], atol=1e-12)
    pressed = commanded(push, (0.55, 2.0, LEAVE)).at(TIMES)
    np.testing.assert_allclose(both[0][:, 3], pressed[0][:, 3], atol=1e-12)


def test_below_the_surface_depth_becomes_force_and_above_it_nothing() -> None:
    arm = CommandedArm(commanded_scene(), ORIGIN, 0.01)
    arm.add(commands((0.0, nan, [0, 0, -0.01, 0, 0, 0]), (1.2, nan, [0, 0, 0.01, 0, 0, 0])))
    drive, _ = arm.at(TIMES)
    late = 0.005 * 0.01  # m, by the ramp to 0.01 m/s at 1 m/s2
    expected = 1000 * np.maximum(0.0, 0.01 * (TIMES[:1200] - 1.0) - late)
    np.testing.assert_allclose(drive[:1200, 3], expected, atol=1e-9)
    assert drive[1199, 3] > 1.9
    assert not drive[-1, 3]


def test_over_a_sphere_it_presses_by_how_far_it_is_below_the_surface_under_it() -> None:
    radius = 0.06
    arm = CommandedArm(commanded_scene("sphere", radius), ORIGIN)
    arm.add(commands((0.0, nan, [0.06, 0.08, -0.04, 0, 0, 0]), (0.2, 1.5, LEAVE)))
    push = 0.0
    for instant in np.arange(0, 0.3, 0.05).tolist():
        (x, y, z, *_), _, push = arm.motion(instant)
        below = np.sqrt(radius**2 - x * x - y * y) - radius - z
        assert push == pytest.approx(1000 * max(0.0, below), abs=1e-9)
        grip = min(1.5, 50 * max(0.0, instant - 0.2))
        assert arm.at(np.array([instant]))[0][0, 3] == pytest.approx(push + grip)
    assert push > 1.0


def test_a_late_command_applies_from_the_latest_simulated_instant_on() -> None:
    arm = commanded()
    arm.at(np.array([1.0]))
    arm.add(commands((0.5, nan, [0.1, 0, 0, 0, 0, 0])))
    drive, _ = arm.at(TIMES[900:])
    assert not drive[:101].any()
    assert drive[101:, 0].all()


@given(st.lists(st.integers(0, 2000), max_size=20).map(sorted), st.integers(0, 20))
def test_requesting_piecewise_and_forgetting_change_nothing(ticks: list[int], cut: int) -> None:
    commands = (0.1, 3.0, LEAVE), (0.1, nan, [0.1, 0, 0, 0, 0, 1]), (0.8, 0.0, [0.0] * 6)
    times = np.array(ticks) * 1e-3
    arm, parts = commanded(*commands), list[tuple[Reals, Reals]]()
    for part in (times[:cut], times[cut:]):
        if len(part):
            arm.forget(float(part[0]))
        parts.append(arm.at(part))
    for whole, *pieces in zip(commanded(*commands).at(times), *parts, strict=True):
        np.testing.assert_array_equal(np.concatenate(pieces), whole)
