"""Commanded motion: a flow commands normal force and arm velocity while the scene runs.

A command replaces the plan from its own time on. With t (s) since then::

    F = F0 + clip(F1 - F0, -r t, r t)             normal force (N), r `Scene.force_rate`
    V = V0 + (V1 - V0) u,  u = clip(t / T, 0, 1)  velocity, T from `Scene.acceleration`, `spin_acceleration`

All sources and fingertips apply a command at the same instant: its own time, or the latest simulated instant
if that is later. So the same commands at the same event times give identical output if each arrives before
its time is simulated: always in virtual time, and on a host that is fast enough.
"""

import math
from bisect import bisect_left, insort
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from connectors.sim.scene import Scene
from operators.batch import Commands, Reals, s


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Position, velocity and normal force of the arm at k instants."""

    drive: Reals  # (k, 6) velocity, force and push, as below
    pose: Reals  # (k, 3) m, m, rad of the TCP, relative to its start, seen along the normal

    @classmethod
    def blank(cls, k: int) -> "Trajectory":
        """Return a trajectory of zeros at k instants."""
        return cls(np.zeros((k, 6)), np.zeros((k, 3)))

    @property
    def velocity(self) -> Reals:
        """View of the TCP velocity in the fingertip's frame: (k, 3) m/s, m/s, rad/s."""
        return self.drive[:, :3]

    @property
    def force(self) -> Reals:
        """View of the normal force: (k,) N."""
        return self.drive[:, 3]

    @property
    def push(self) -> Reals:
        """View of the external force in the fingertip's frame: (k, 2) N."""
        return self.drive[:, 4:]

    def __len__(self) -> int:
        return len(self.pose)

    def __getitem__(self, rows: slice) -> "Trajectory":
        """Return a view of some instants."""
        return Trajectory(self.drive[rows], self.pose[rows])

    def without(self, rows: NDArray[np.intp]) -> "Trajectory":
        """Return a copy without some instants."""
        return Trajectory(np.delete(self.drive, rows, axis=0), np.delete(self.pose, rows, axis=0))


@dataclass(frozen=True, slots=True)
class Setpoint:
    """Target of one command."""

    time: int  # ns, from which it applies
    force: float  # N; NaN for no change
    velocity: tuple[float, float, float]  # m/s, m/s, rad/s seen along the normal; NaN for no change


class CommandQueue:
    """Commands of one run in the order of their times, kept until every arm has passed them.

    Attributes:
        setpoints: Pending setpoints.
        dropped: Number of setpoints that were dropped before the first pending one.
    """

    def __init__(self) -> None:
        self.setpoints: list[Setpoint] = []
        self.dropped = 0
        self._origin = self._simulated = 0  # ns

    def begin(self, origin: int) -> None:
        """Begin a run at `origin` (ns)."""
        self._origin = self._simulated = origin

    def add(self, commands: Commands) -> None:
        """Add commands; a time that is already simulated becomes the latest simulated time."""
        rows = zip(commands.time.tolist(), commands.force.tolist(), commands.velocity, strict=True)
        for time, force, (x, y, _, _, _, spin) in rows:
            grip = max(force, 0.0)  # in this order NaN stays NaN
            setpoint = Setpoint(max(time, self._simulated), grip, (float(x), -float(y), -float(spin)))
            insort(self.setpoints, setpoint, key=attrgetter("time"))

    def drop_before(self, instant: int) -> None:
        """Drop setpoints before an instant (ns) that every arm of the run has passed."""
        done = bisect_left(self.setpoints, instant, key=attrgetter("time"))
        self.dropped += done
        del self.setpoints[:done]

    def instant(self, setpoint: Setpoint) -> float:
        """Return the instant at which a setpoint applies (s since the run began)."""
        return max(0, setpoint.time - self._origin) / s

    def mark_simulated(self, instant: float) -> None:
        """Record that the scene is simulated up to `instant` (s)."""
        self._simulated = max(self._simulated, self._origin + round(instant * s))


class CommandFollower:
    """Follower of commands, which replace the planned trajectory of one arm.

    Args:
        commands: Queue of commands, which may grow during the run.
        scene: Scene with the rates at which force and velocity change.
    """

    def __init__(self, commands: CommandQueue, scene: Scene) -> None:
        self._commands, self._scene = commands, scene
        self._applied = 0  # number of applied setpoints, including dropped ones
        self._grip: tuple[float, float, float] | None = None  # start (s), initial and final force (N)
        # start (s), pose, initial and final velocity
        self._course: tuple[float, Reals, Reals, Reals] | None = None

    def trajectory(self, times: Reals, planned: Callable[[Reals], Trajectory]) -> Trajectory:
        """Return the trajectory at increasing instants (k,) (s); shorter if the plan ends before the last."""
        pending, first = self._commands.setpoints, self._applied - self._commands.dropped
        due = first
        while due < len(pending) and len(times) and self._commands.instant(pending[due]) <= times[-1]:
            due += 1
        if len(times):
            self._commands.mark_simulated(float(times[-1]))
        setpoints, self._applied = pending[first:due], due + self._commands.dropped
        if not setpoints and self._grip is None and self._course is None:
            return planned(times)
        turns = np.array([self._commands.instant(setpoint) for setpoint in setpoints])  # (setpoints,) s
        positions = np.searchsorted(times, turns)
        times, rows = np.insert(times, positions, turns), positions + np.arange(len(turns))
        path, begin = planned(times), 0
        for setpoint, row in zip(setpoints, rows.tolist(), strict=True):
            if row >= len(path):
                break
            self._replace(times[begin : row + 1], path[begin : row + 1])
            self._apply(setpoint, float(times[row]), path[row : row + 1])
            begin = row + 1
        self._replace(times[begin : len(path)], path[begin:])
        return path.without(rows[rows < len(path)]) if setpoints else path

    def _apply(self, setpoint: Setpoint, now: float, path: Trajectory) -> None:
        """Set the targets; the values at this instant remain, because the trajectory is continuous."""
        if not math.isnan(setpoint.force):
            self._grip = now, float(path.force[0]), setpoint.force
        if not any(map(math.isnan, setpoint.velocity)):
            vx, vy, spin = path.velocity[0].tolist()
            cos, sin = math.cos(path.pose[0, 2]), math.sin(path.pose[0, 2])
            velocity = np.array([cos * vx - sin * vy, sin * vx + cos * vy, spin])
            self._course = now, path.pose[0].copy(), velocity, np.array(setpoint.velocity)

    def _replace(self, times: Reals, path: Trajectory) -> None:
        """Replace the commanded quantities at instants (k,) (s)."""
        if self._grip is not None:
            since, first, last = self._grip
            change = self._scene.force_rate * (times - since)
            path.force[:] = first + np.clip(last - first, -change, change)
        if self._course is not None:
            since, pose, before, after = self._course
            vx, vy, spin = (after - before).tolist()
            ramp = max(
                math.hypot(vx, vy) / self._scene.acceleration, abs(spin) / self._scene.spin_acceleration, 1e-9
            )
            t = (times - since)[:, None]  # (k, 1)
            u = np.clip(t / ramp, 0.0, 1.0)
            velocity = before + (after - before) * u  # (k, 3) in the frame of the pose
            path.pose[:] = (
                pose + before * t + (after - before) * (ramp * u * u / 2 + np.maximum(t - ramp, 0.0))
            )
            cos, sin = np.cos(path.pose[:, 2]), np.sin(path.pose[:, 2])
            path.velocity[:, 0] = cos * velocity[:, 0] + sin * velocity[:, 1]
            path.velocity[:, 1] = cos * velocity[:, 1] - sin * velocity[:, 0]
            path.velocity[:, 2] = velocity[:, 2]
