from dataclasses import dataclass, field

import numpy as np

from connectors.emulators.free_arm import FreeArm
from connectors.emulators.pressing_arm import PressingArm
from operators import Commands, ms, s
from operators.batch import Reals


@dataclass
class Plane:
    """Moves along x and y, and remembers the forces that it is told."""

    arm: FreeArm = field(default_factory=lambda: FreeArm(np.zeros(6)))
    forces: list[float] = field(default_factory=list[float])

    def motion(self, time: int) -> tuple[Reals, Reals]:
        return self.arm.motion(time)

    def command(self, commands: Commands) -> None:
        self.forces += [force for force in commands.force.tolist() if not np.isnan(force)]
        flat = commands.velocity.copy()
        flat[:, 2] = 0.0
        self.arm.command(Commands(commands.time, commands.force, flat))


def go(time: int, *velocity: float) -> Commands:
    return Commands(np.array([time]), np.array([np.nan]), np.array([[*velocity, 0.0, 0.0, 0.0]]))


def test_below_the_surface_depth_becomes_force_and_above_it_nothing() -> None:
    plane = Plane()
    arm = PressingArm(plane, height=0.01, stiffness=1000.0, acceleration=np.inf)
    arm.command(go(0, 0.0, 0.0, -0.01))
    heights = [arm.motion(time)[0][2] for time in range(0, 1_200 * ms + 1, 100 * ms)]
    np.testing.assert_allclose(heights, 0.01 - np.arange(13) * 0.001, atol=1e-12)
    np.testing.assert_allclose(plane.forces, [1.0, 2.0], atol=1e-9)
    arm.command(go(1_200 * ms, 0.0, 0.0, 0.01))
    arm.motion(3 * s)
    assert plane.forces[-1] == 0.0


def test_what_goes_along_the_surface_goes_as_it_went() -> None:
    arm = PressingArm(Plane(), height=0.01)
    arm.command(go(0, 0.1, -0.2, 0.0))
    pose, velocity = arm.motion(0)
    pose, velocity = arm.motion(1 * s)
    np.testing.assert_allclose(pose, [0.1, -0.2, 0.01, 0, 0, 0])
    np.testing.assert_allclose(velocity, [0.1, -0.2, 0, 0, 0, 0])


def test_over_a_sphere_it_presses_by_how_far_it_is_below_the_surface_under_it() -> None:
    radius, plane = 0.06, Plane()
    arm = PressingArm(plane, 0.0, 1000.0, np.inf, curvatures=(1 / radius, 1 / radius))
    arm.command(go(0, 0.06, 0.08, -0.04))
    for time in range(0, 300 * ms + 1, 50 * ms):
        (x, y, z, *_), _ = arm.motion(time)
        below = np.sqrt(radius**2 - x * x - y * y) - radius - z
        np.testing.assert_allclose(arm.wrench[2], 1000 * max(0.0, below), atol=1e-9)
    assert plane.forces[-1] == arm.wrench[2] > 1.0


def test_the_surface_pushes_the_tool_up_and_what_is_in_the_air_is_not_pushed() -> None:
    arm = PressingArm(Plane(), height=0.001, stiffness=1000.0, acceleration=np.inf)
    arm.motion(0)
    assert not arm.wrench.any()
    arm.command(go(0, 0.0, 0.0, -0.01))
    arm.motion(0)
    arm.motion(300 * ms)
    np.testing.assert_allclose(arm.wrench, [0, 0, 2.0, 0, 0, 0], atol=1e-9)
