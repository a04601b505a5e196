"""Arm of the virtual lab: its velocity and grip force follow commands; it presses the surface below it.

With t (s) since a command::

    G = G0 + clip(G1 - G0, -r t, r t)             grip force (N), r `FORCE_RATE`
    V = V0 + (V1 - V0) u,  u = clip(t / T, 0, 1)  velocity, T from `Scene.acceleration`, `SPIN_ACCELERATION`
    F = G + k max(0, -drop(x, y) - z)             normal force (N), k `STIFFNESS`, z height of the TCP

All devices apply a command at the same instant: its own time, or the latest simulated instant if that is
later. So the same commands and requests at the same times give identical output.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from connectors.sim.arm_motion import SPIN_ACCELERATION
from connectors.sim.scene import Scene, surface_drop
from operators.batch import Commands, Reals, s

FORCE_RATE: Final = 50.0  # N/s; assumed
STIFFNESS: Final = 1000.0  # N/m of fingertip, arm and surface in series; assumed


@dataclass(frozen=True, slots=True)
class Segment:
    """Motion between two commands."""

    start: float  # s
    first: float  # N, grip force at the start
    last: float  # N after the change
    pose: Reals  # (4,) m, m, rad and height in m at the start
    before: Reals  # (4,) m/s, m/s, rad/s, m/s at the start, in the frame of the pose
    after: Reals  # (4,) after the ramp
    ramp: float  # s

    def at(self, times: Reals) -> tuple[Reals, Reals, Reals]:
        """Return grip force (k,), velocity and pose (k, 4) in the pose's frame at instants (k,) (s)."""
        t = times - self.start
        force = self.first + np.clip(self.last - self.first, -FORCE_RATE * t, FORCE_RATE * t)
        t = t[:, None]
        u = np.clip(t / self.ramp, 0.0, 1.0)
        change = self.after - self.before
        travel = self.before * t + change * (self.ramp * u * u / 2 + np.maximum(t - self.ramp, 0.0))
        return force, self.before + change * u, self.pose + travel


class CommandedArm:
    """An arm that stands still in the air until it is commanded.

    Args:
        scene: Scene with the surface; its acceleration limits the arm.
        origin: Beginning of the run (ns).
        height: Initial height above the middle of the surface (m, default 0).
    """

    def __init__(self, scene: Scene, origin: int, height: float = 0.0) -> None:
        self._scene, self._origin = scene, origin
        self._simulated = 0.0  # s, latest instant
        pose = np.array([0.0, 0.0, 0.0, height])
        self._segments = [Segment(0.0, 0.0, 0.0, pose, np.zeros(4), np.zeros(4), 1.0)]

    def add(self, commands: Commands) -> None:
        """Add commands in order; a time that is already simulated becomes the latest simulated time."""
        rows = zip(commands.time.tolist(), commands.force.tolist(), commands.velocity.tolist(), strict=True)
        for time, force, (x, y, z, _, _, spin) in rows:
            latest = self._segments[-1]
            start = max((time - self._origin) / s, self._simulated, latest.start)
            [first], [before], [pose] = latest.at(np.array([start]))
            after = latest.after if np.isnan([x, y, z, spin]).any() else np.array([x, -y, -spin, z])
            last = latest.last if math.isnan(force) else max(force, 0.0)
            vx, vy, turn, vz = (after - before).tolist()
            ramp = max(math.hypot(vx, vy, vz) / self._scene.acceleration, abs(turn) / SPIN_ACCELERATION, 1e-9)
            self._segments.append(Segment(start, float(first), last, pose, before, after, ramp))

    def forget(self, instant: float) -> None:
        """Forget the motion before an instant (s); `at` is not called for it again."""
        while len(self._segments) > 1 and self._segments[1].start <= instant:
            del self._segments[0]

    def at(self, times: Reals) -> tuple[Reals, Reals]:
        """Return drive (k, 6) and pose (k, 3) at increasing instants (k,) (s); see `PlannedArm.at`."""
        force, velocity, pose, push = self._states(times)
        drive = np.zeros((len(times), 6))
        cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        drive[:, 0] = cos * velocity[:, 0] + sin * velocity[:, 1]
        drive[:, 1] = cos * velocity[:, 1] - sin * velocity[:, 0]
        drive[:, 2], drive[:, 3] = velocity[:, 2], force + push
        return drive, pose[:, :3]

    def motion(self, instant: float) -> tuple[Reals, Reals, float]:
        """Return pose (6,), velocity (6,) and force of the surface (N) at an instant (s); base frame."""
        _, [[vx, vy, spin, rise]], [[x, y, yaw, height]], [push] = self._states(np.array([instant]))
        pose = np.array([x, -y, height, math.pi * math.cos(yaw / 2), -math.pi * math.sin(yaw / 2), 0.0])
        return pose, np.array([vx, -vy, rise, 0.0, 0.0, -spin]), float(push)

    def _states(self, times: Reals) -> tuple[Reals, Reals, Reals, Reals]:
        """Return grip force (k,), velocity (k, 4), pose (k, 4) and force of the surface (k,)."""
        force, velocity, pose = np.zeros(len(times)), np.zeros((len(times), 4)), np.zeros((len(times), 4))
        if len(times):
            self._simulated = max(self._simulated, float(times[-1]))
        bounds = np.searchsorted(times, [segment.start for segment in self._segments[1:]])
        for segment, begin, end in zip(self._segments, [0, *bounds], [*bounds, len(times)], strict=True):
            force[begin:end], velocity[begin:end], pose[begin:end] = segment.at(times[begin:end])
        curvatures, drop = self._scene.curvatures, np.zeros(len(times))  # (k,) m
        if any(curvatures):
            drop[:] = [surface_drop(curvatures, x, y) for x, y in pose[:, :2].tolist()]
        return force, velocity, pose, STIFFNESS * np.maximum(0.0, -drop - pose[:, 3])
