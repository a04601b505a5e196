import numpy as np
import pytest

from operators.batch import Commands, Reals, s
from tests.connectors.emulators.free_arm import FreeArm

NEVER = np.full(6, np.nan)


def order(time: float, *velocity: float) -> Commands:
    aim = np.array([*velocity, *[0.0] * (6 - len(velocity))]) if velocity else NEVER
    return Commands(np.array([round(time * s)]), np.array([np.nan]), aim[None])


def at(arm: FreeArm, time: float) -> tuple[Reals, Reals]:
    return arm.motion(round(time * s))


def test_it_stands_until_it_is_commanded_and_obeys_from_the_commands_time() -> None:
    arm = FreeArm(np.array([1.0, 2, 3, 0, 0, 0]))
    assert at(arm, 0.0)[0].tolist() == [1, 2, 3, 0, 0, 0]
    arm.command(order(2.0, 0.5))
    arm.command(order(3.0))  # no velocity: it goes on
    arm.command(order(4.0, 0.0, 1.0))
    pose, velocity = at(arm, 5.0)
    assert pose.tolist() == pytest.approx([2, 3, 3, 0, 0, 0])
    assert velocity.tolist() == [0, 1, 0, 0, 0, 0]


@pytest.mark.parametrize("looks", [1, 7, 1000])
def test_it_changes_its_velocity_at_its_acceleration_however_often_one_looks(looks: int) -> None:
    arm = FreeArm(np.zeros(6), acceleration=2.0)
    arm.command(order(0.0, 1.0))
    poses = [at(arm, time)[0] for time in np.linspace(0, 2, looks + 1)]
    assert poses[-1][0] == pytest.approx(0.5**2 + 1.5)


def test_it_turns_about_the_axes_of_the_base() -> None:
    arm = FreeArm(np.array([0.0, 0, 0, np.pi, 0, 0]))  # it looks down
    at(arm, 0.0)
    arm.command(order(0.0, 0, 0, 0, 0, 0, 0.5))
    pose, _ = at(arm, 1.0)
    assert pose[3:].tolist() == pytest.approx([np.pi * np.cos(0.25), np.pi * np.sin(0.25), 0])
