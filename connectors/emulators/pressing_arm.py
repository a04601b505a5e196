"""Arm with a height, whose depth below the surface becomes the normal force on the fingertip.

The simulated scene has a normal force instead of a height. The normal force here is proportional to the depth
of the TCP below the flat or curved surface.
"""

from typing import Final

import numpy as np

from connectors.emulators.free_arm import Arm, FreeArm
from connectors.sim.scene import surface_drop
from operators.batch import Commands, Reals

STIFFNESS: Final = 1000.0  # N/m of fingertip, arm and surface in series; assumed
FORCE_TOLERANCE: Final = 0.01  # N; smaller changes are not commanded
_Z: Final = 2


class PressingArm:
    """An arm along a surface, extended by a height and a contact force; the origin is the highest point.

    Args:
        plane: Arm that moves along the surface.
        height: Initial height (m).
        stiffness: Force per depth below the surface (N/m, default 1000).
        acceleration: Acceleration along z (m/s2, default 1).
        curvatures: Curvatures of the surface along x and y (1/m, default flat).

    >>> arm = PressingArm(FreeArm(np.zeros(6)), height=0.02)
    >>> arm.motion(0)[0].tolist()
    [0.0, 0.0, 0.02, 0.0, 0.0, 0.0]
    """

    def __init__(
        self,
        plane: Arm,
        height: float,
        stiffness: float = STIFFNESS,
        acceleration: float = 1.0,
        curvatures: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self._plane, self._stiffness, self._curvatures = plane, stiffness, curvatures
        self._vertical = FreeArm(np.array([0.0, 0.0, height, 0.0, 0.0, 0.0]), acceleration)
        self._force = self._commanded = 0.0  # N, current and last commanded force

    def motion(self, time: int) -> tuple[Reals, Reals]:
        """Return pose (6,) and velocity (6,) of the TCP at a host time (ns), and command the force there."""
        pose, velocity = self._plane.motion(time)
        height, speed = self._vertical.motion(time)
        pose[_Z], velocity[_Z] = height[_Z], speed[_Z]
        surface = -surface_drop(self._curvatures, float(pose[0]), float(pose[1]))  # m
        force = self._force = self._stiffness * max(0.0, surface - float(height[_Z]))
        if abs(force - self._commanded) > FORCE_TOLERANCE or (force == 0.0) != (self._commanded == 0.0):
            self._commanded = force
            self._plane.command(Commands(np.array([time]), np.array([force]), np.full((1, 6), np.nan)))
        return pose, velocity

    @property
    def wrench(self) -> Reals:
        """Force (N) and torque (N m) of the surface on the tool at the latest motion, (6,), base frame.

        Friction and torque are not modelled.
        """
        return np.array([0.0, 0.0, self._force, 0.0, 0.0, 0.0])

    def command(self, commands: Commands) -> None:
        """Apply velocities and forces from their times on."""
        self._plane.command(commands)
        upward = np.zeros_like(commands.velocity)  # (n, 6)
        upward[:, _Z] = commands.velocity[:, _Z]  # NaN for no command
        self._vertical.command(Commands(commands.time, commands.force, upward))
