"""An arm that presses: its height, which the scene does not have, becomes the force on the fingertip.

The scene's fingertip follows the surface it touches, flat or curved, as one that can tilt does. So the arm,
which does not turn for that, presses by how far it is below the surface under its TCP.
"""

from typing import Final, Protocol

import numpy as np

from connectors.emulators.free_arm import FreeArm
from connectors.sim.scene import surface_drop
from operators.batch import Commands, Reals

STIFFNESS: Final = 1000.0  # N/m, of fingertip, arm and surface together; assumed
_SLIGHT: Final = 0.01  # N, a change of the force that the scene is not told of
_Z: Final = 2


class Plane(Protocol):
    """What moves along the surface and is pressed onto it: a `connectors.emulators.shared_scene.Lab`."""

    def motion(self, time: int) -> tuple[Reals, Reals]:
        """Pose (6,) and velocity (6,) of the TCP at a host time (ns)."""
        ...

    def command(self, commands: Commands) -> None:
        """Obey force and velocity from the commands' own times on."""
        ...


class PressingArm:
    """Adds a height to an arm that moves along a surface, whose highest point is at z = 0, in the middle.

    Args:
        plane: What it moves.
        height: At first, m.
        stiffness: Force for each metre below the surface, N/m.
        acceleration: At which it changes its velocity along z, m/s2.
        curvatures: Of the surface, along x and along y, 1/m.

    >>> arm = PressingArm(FreeArm(np.zeros(6)), height=0.02)
    >>> arm.motion(0)[0].tolist()
    [0.0, 0.0, 0.02, 0.0, 0.0, 0.0]
    """

    def __init__(
        self,
        plane: Plane,
        height: float,
        stiffness: float = STIFFNESS,
        acceleration: float = 1.0,
        curvatures: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self._plane, self._stiffness, self._curvatures = plane, stiffness, curvatures
        self._vertical = FreeArm(np.array([0.0, 0.0, height, 0.0, 0.0, 0.0]), acceleration)
        self._push = self._force = 0.0  # N: now, and what the plane was told of last

    def motion(self, time: int) -> tuple[Reals, Reals]:
        """Pose (6,) and velocity (6,) of the TCP at a host time (ns) that never goes back; presses."""
        pose, velocity = self._plane.motion(time)
        along, speed = self._vertical.motion(time)
        pose[_Z], velocity[_Z] = along[_Z], speed[_Z]
        surface = -surface_drop(self._curvatures, float(pose[0]), float(pose[1]))  # m
        force = self._push = self._stiffness * max(0.0, surface - float(along[_Z]))
        if abs(force - self._force) > _SLIGHT or (force == 0.0) != (self._force == 0.0):
            self._force = force
            self._plane.command(Commands(np.array([time]), np.array([force]), np.full((1, 6), np.nan)))
        return pose, velocity

    @property
    def wrench(self) -> Reals:
        """Force (N) and torque (N m) that the surface exerts on the tool as of the newest motion, (6,).

        In the base frame. Only its height is known here: friction, and a torque, are left out.
        """
        return np.array([0.0, 0.0, self._push, 0.0, 0.0, 0.0])

    def command(self, commands: Commands) -> None:
        """Obey velocities and forces from their times on."""
        self._plane.command(commands)
        upward = np.zeros_like(commands.velocity)  # (n, 6)
        upward[:, _Z] = commands.velocity[:, _Z]  # where it is NaN, nothing is commanded
        self._vertical.command(Commands(commands.time, commands.force, upward))
