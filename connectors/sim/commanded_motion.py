"""Arm of the virtual lab: its normal force and velocity follow commands.

With t (s) since a command::

    F = F0 + clip(F1 - F0, -r t, r t)             normal force (N), r `FORCE_RATE`
    V = V0 + (V1 - V0) u,  u = clip(t / T, 0, 1)  velocity, T from `Scene.acceleration`, `SPIN_ACCELERATION`

All devices apply a command at the same instant: its own time, or the latest simulated instant if that is
later. So the same commands and requests at the same times give identical output.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from connectors.sim.arm_motion import SPIN_ACCELERATION
from connectors.sim.scene import Scene
from operators.batch import Commands, Reals, s

FORCE_RATE: Final = 50.0  # N/s; assumed


@dataclass(frozen=True, slots=True)
class Segment:
    """Motion between two commands."""

    start: float  # s
    first: float  # N at the start
    last: float  # N after the change
    pose: Reals  # (3,) m, m, rad at the start
    before: Reals  # (3,) m/s, m/s, rad/s at the start, in the frame of the pose
    after: Reals  # (3,) after the ramp
    ramp: float  # s

    def at(self, times: Reals) -> tuple[Reals, Reals, Reals]:
        """Return force (k,), velocity (k, 3) in the pose's frame and pose (k, 3) at instants (k,) (s)."""
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
        scene: Scene whose acceleration limits the arm.
        origin: Beginning of the run (ns).
    """

    def __init__(self, scene: Scene, origin: int) -> None:
        self._acceleration, self._origin = scene.acceleration, origin
        self._simulated = 0.0  # s, latest instant
        self._segments = [Segment(0.0, 0.0, 0.0, np.zeros(3), np.zeros(3), np.zeros(3), 1.0)]

    def add(self, commands: Commands) -> None:
        """Add commands in order; a time that is already simulated becomes the latest simulated time."""
        rows = zip(commands.time.tolist(), commands.force.tolist(), commands.velocity.tolist(), strict=True)
        for time, force, (x, y, _, _, _, spin) in rows:
            latest = self._segments[-1]
            start = max((time - self._origin) / s, self._simulated, latest.start)
            [first], [before], [pose] = latest.at(np.array([start]))
            after = latest.after if np.isnan([x, y, spin]).any() else np.array([x, -y, -spin])
            last = latest.last if math.isnan(force) else max(force, 0.0)
            vx, vy, turn = (after - before).tolist()
            ramp = max(math.hypot(vx, vy) / self._acceleration, abs(turn) / SPIN_ACCELERATION, 1e-9)
            self._segments.append(Segment(start, float(first), last, pose, before, after, ramp))

    def forget(self, instant: float) -> None:
        """Forget the motion before an instant (s); `at` is not called for it again."""
        while len(self._segments) > 1 and self._segments[1].start <= instant:
            del self._segments[0]

    def at(self, times: Reals) -> tuple[Reals, Reals]:
        """Return drive (k, 6) and pose (k, 3) at increasing instants (k,) (s); see `PlannedArm.at`."""
        drive, pose = np.zeros((len(times), 6)), np.zeros((len(times), 3))
        if not len(times):
            return drive, pose
        self._simulated = max(self._simulated, float(times[-1]))
        bounds = np.searchsorted(times, [segment.start for segment in self._segments[1:]])
        for segment, begin, end in zip(self._segments, [0, *bounds], [*bounds, len(times)], strict=True):
            rows = slice(begin, end)
            drive[rows, 3], velocity, pose[rows] = segment.at(times[rows])
            cos, sin = np.cos(pose[rows, 2]), np.sin(pose[rows, 2])
            drive[rows, 0] = cos * velocity[:, 0] + sin * velocity[:, 1]
            drive[rows, 1] = cos * velocity[:, 1] - sin * velocity[:, 0]
            drive[rows, 2] = velocity[:, 2]
        return drive, pose
