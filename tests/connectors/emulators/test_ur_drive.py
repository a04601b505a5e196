from collections.abc import Iterator

import numpy as np
import pytest

from connectors.emulators.ur_drive import POSE_TOLERANCE, Drive
from operators.batch import Commands, Reals, s
from tests.connectors.emulators.free_arm import FreeArm

DOWN = np.array([0.4, -0.2, 0.1, np.pi, 0.0, 0.0])


def cycles(drive: Drive, arm: FreeArm, rate: float, seconds: float = 10.0) -> Iterator[tuple[Reals, Reals]]:
    """Let the arm follow until the task is done: pose and velocity at each cycle."""
    for cycle in range(round(seconds * rate)):
        time = round(cycle / rate * s)
        pose, velocity = arm.motion(time)
        yield pose, velocity
        drive.step(pose, velocity)
        if drive.task == "none":
            return
        arm.command(Commands(np.array([time]), np.array([np.nan]), drive.velocity[None]))


@pytest.mark.parametrize("rate", [125.0, 500.0])
@pytest.mark.parametrize("acceleration", [np.inf, 1.0])
@pytest.mark.parametrize(
    "change",
    [
        [0.05, 0.02, 0, 0, 0, 0],
        [-0.001, 0, 0, 0, 0, 0],
        [0, 0, -0.2, 0, 0, 0],
        [0.1, 0, 0, 0, 0, 0.5],
        [0, 0, 0, 0, 0, -1.0],
        [0, 0, 0, 0, 0, 0],
    ],
    ids=str,
)
def test_a_line_ends_where_it_should_and_never_goes_faster(
    rate: float, acceleration: float, change: list[float]
) -> None:
    drive, arm = Drive(1 / rate), FreeArm(np.zeros(6), acceleration)
    drive.line(np.array(change), 0.1, 1.0)
    path = list(cycles(drive, arm, rate, 20.0))
    poses, velocities = np.array([each[0] for each in path]), np.array([each[1] for each in path])
    assert drive.task == "none"
    np.testing.assert_allclose(poses[-1], change, atol=2 * POSE_TOLERANCE)
    speed = np.maximum(*(np.linalg.norm(velocities[:, part], axis=1) for part in (slice(3), slice(3, 6))))
    assert speed.max() < 0.1 + 1e-9
    longest = max(np.linalg.norm(change[:3]), np.linalg.norm(change[3:]))
    assert len(path) / rate < longest / 0.1 + 0.1 / 1.0 + 1.0
    along = poses @ np.array(change) / max(np.dot(change, change), 1e-12)  # 0 to 1
    assert np.diff(along).min(initial=0) > -1e-4  # it does not swing
    np.testing.assert_allclose(poses, along[:, None] * np.array(change), atol=2e-4)  # nor leave its line


def test_a_line_turns_the_short_way_in_the_frame_of_the_base() -> None:
    drive, arm = Drive(0.002), FreeArm(DOWN)
    turned = np.pi * np.cos(0.3), np.pi * np.sin(0.3), 0.0  # by 0.6 about z
    target = np.array([*DOWN[:3], *turned])
    drive.line(target, 0.5, 1.0)
    velocities = np.array([velocity for _, velocity in cycles(drive, arm, 500.0)])
    np.testing.assert_allclose(arm.motion(10**12)[0], target, atol=2 * POSE_TOLERANCE)
    assert np.abs(velocities[:, :5]).max() < 1e-4
    assert velocities[:, 5].max() == pytest.approx(0.5)


def test_a_speed_is_reached_at_its_acceleration_and_kept() -> None:
    drive, arm = Drive(0.008), FreeArm(np.zeros(6))
    drive.speed(np.array([0.08, 0, 0, 0, 0, -0.4]), 0.5)
    velocities = np.array([velocity for _, velocity in cycles(drive, arm, 125.0, 2.0)])
    assert velocities[-1].tolist() == pytest.approx([0.08, 0, 0, 0, 0, -0.4])
    assert np.abs(np.diff(velocities[:, 0])).max() == pytest.approx(0.5 * 0.008)
    assert np.abs(np.diff(velocities[:, 5])).max() == pytest.approx(0.5 * 0.008)
    assert drive.task == "speed"


def test_a_stop_slows_down_and_is_done_when_the_arm_stands() -> None:
    drive, arm = Drive(0.008), FreeArm(np.zeros(6), acceleration=0.2)  # it lags behind
    drive.speed(np.array([0.1, 0, 0, 0, 0, 0]), 1.0)
    list(cycles(drive, arm, 125.0, 2.0))
    drive.stop(0.4)
    later = Drive(0.008)
    later.velocity = drive.velocity
    seen = list[float]()
    for cycle in range(1000):
        time = 3 * s + cycle * 8_000_000
        pose, velocity = arm.motion(time)
        seen.append(float(velocity[0]))
        drive.step(pose, velocity)
        if drive.task == "none":
            break
        arm.command(Commands(np.array([time]), np.array([np.nan]), drive.velocity[None]))
    assert seen[0] == pytest.approx(0.1)
    assert seen[-1] < 1e-3
    assert 0.1 / 0.2 < len(seen) * 0.008 < 0.1 / 0.2 + 0.3
