"""The rig's hand: a flow commands grip force and arm motion while the scene runs.

What is commanded replaces what the plan says, from the command's own time on. With t (s) since then::

    F = F0 + clip(F1 - F0, -r t, r t)             normal force (N), r `Scene.force_rate`
    V = V0 + (V1 - V0) u,  u = clip(t / T, 0, 1)  velocity, T from `Scene.acceleration`, `spin_acceleration`

Both sources and all fingertips obey at one instant: the command's, or the furthest that any of them has
simulated by then. So the same commands at the same event times give the same bytes, as long as each arrives
before its time is simulated: always in virtual time, and on a host that keeps the pace.
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
    """Where the arm is, how it moves and how hard it presses at k instants."""

    drive: Reals  # (k, 6) what follows, side by side
    place: Reals  # (k, 3) m, m, rad of the TCP, seen along the normal from where it began

    @classmethod
    def blank(cls, k: int) -> "Trajectory":
        """Nothing yet, at k instants."""
        return cls(np.zeros((k, 6)), np.zeros((k, 3)))

    @property
    def velocity(self) -> Reals:
        """Of the TCP in the fingertip's frame, a view: (k, 3) m/s, m/s, rad/s."""
        return self.drive[:, :3]

    @property
    def force(self) -> Reals:
        """Normal force, a view: (k,) N."""
        return self.drive[:, 3]

    @property
    def push(self) -> Reals:
        """From outside, in the fingertip's frame, a view: (k, 2) N."""
        return self.drive[:, 4:]

    def __len__(self) -> int:
        return len(self.place)

    def __getitem__(self, rows: slice) -> "Trajectory":
        """A view of some of the instants."""
        return Trajectory(self.drive[rows], self.place[rows])

    def without(self, rows: NDArray[np.intp]) -> "Trajectory":
        """A copy without some of the instants."""
        return Trajectory(np.delete(self.drive, rows, axis=0), np.delete(self.place, rows, axis=0))


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What one command aims at."""

    time: int  # ns, from which it is obeyed
    force: float  # N; NaN: as it was
    velocity: tuple[float, float, float]  # m/s, m/s, rad/s seen along the normal; NaN: as it was


class CommandQueue:
    """The commands of one run, in the order in which they are obeyed; they are kept for each arm to obey."""

    def __init__(self) -> None:
        self.given: list[Setpoint] = []
        self.forgotten = 0  # aims that came before the first of `given`
        self._origin = self._reached = 0  # ns

    def begin(self, origin: int) -> None:
        """A run begins at `origin` (ns)."""
        self._origin = self._reached = origin

    def give(self, commands: Commands) -> None:
        """Take commands; what is already simulated stays as it is."""
        rows = zip(commands.time.tolist(), commands.force.tolist(), commands.velocity, strict=True)
        for time, force, (x, y, _, _, _, turn) in rows:
            grip = max(force, 0.0)  # in this order: NaN stays NaN
            aim = Setpoint(max(time, self._reached), grip, (float(x), -float(y), -float(turn)))
            insort(self.given, aim, key=attrgetter("time"))

    def forget(self, before: int) -> None:
        """Drop what was to be obeyed before an instant (ns) that every arm of the run has passed."""
        done = bisect_left(self.given, before, key=attrgetter("time"))
        self.forgotten += done
        del self.given[:done]

    def instant(self, aim: Setpoint) -> float:
        """When it is obeyed, s since the run began."""
        return max(0, aim.time - self._origin) / s

    def reach(self, instant: float) -> None:
        """The scene is simulated up to `instant` (s)."""
        self._reached = max(self._reached, self._origin + round(instant * s))


class CommandFollower:
    """Bends one arm's planned path to the orders.

    Args:
        orders: They may grow while the arm moves, beyond what is simulated.
        scene: Says how fast force and velocity can change.
    """

    def __init__(self, orders: CommandQueue, scene: Scene) -> None:
        self._orders, self._scene = orders, scene
        self._obeyed = 0  # of the orders, the forgotten ones included
        self._grip: tuple[float, float, float] | None = None  # s, N, N: since when, from, to
        self._course: tuple[float, Reals, Reals, Reals] | None = None  # since when, place, from, to

    def path(self, times: Reals, planned: Callable[[Reals], Trajectory]) -> Trajectory:
        """The path at instants (k,) (s) that never go back; shorter where the plan ends before the last."""
        given, first = self._orders.given, self._obeyed - self._orders.forgotten
        due = first
        while due < len(given) and len(times) and self._orders.instant(given[due]) <= times[-1]:
            due += 1
        if len(times):
            self._orders.reach(float(times[-1]))
        aims, self._obeyed = given[first:due], due + self._orders.forgotten
        if not aims and self._grip is None and self._course is None:
            return planned(times)
        turns = np.array([self._orders.instant(aim) for aim in aims])  # (aims,) s
        places = np.searchsorted(times, turns)
        times, rows = np.insert(times, places, turns), places + np.arange(len(turns))
        path, begin = planned(times), 0
        for aim, row in zip(aims, rows.tolist(), strict=True):
            if row >= len(path):
                break
            self._bend(times[begin : row + 1], path[begin : row + 1])
            self._obey(aim, float(times[row]), path[row : row + 1])
            begin = row + 1
        self._bend(times[begin : len(path)], path[begin:])
        return path.without(rows[rows < len(path)]) if aims else path

    def _obey(self, aim: Setpoint, now: float, path: Trajectory) -> None:
        """Change the aims; nothing jumps, so the path at this instant stays as it is."""
        if not math.isnan(aim.force):
            self._grip = now, float(path.force[0]), aim.force
        if not any(map(math.isnan, aim.velocity)):
            vx, vy, spin = path.velocity[0].tolist()
            cos, sin = math.cos(path.place[0, 2]), math.sin(path.place[0, 2])
            velocity = np.array([cos * vx - sin * vy, sin * vx + cos * vy, spin])
            self._course = now, path.place[0].copy(), velocity, np.array(aim.velocity)

    def _bend(self, times: Reals, path: Trajectory) -> None:
        """Replace what is commanded at instants (k,)."""
        if self._grip is not None:
            since, first, last = self._grip
            change = self._scene.force_rate * (times - since)
            path.force[:] = first + np.clip(last - first, -change, change)
        if self._course is not None:
            since, place, before, after = self._course
            vx, vy, spin = (after - before).tolist()
            ramp = max(
                math.hypot(vx, vy) / self._scene.acceleration, abs(spin) / self._scene.spin_acceleration, 1e-9
            )
            t = (times - since)[:, None]  # (k, 1)
            u = np.clip(t / ramp, 0.0, 1.0)
            velocity = before + (after - before) * u  # (k, 3) in the frame of the place
            path.place[:] = (
                place + before * t + (after - before) * (ramp * u * u / 2 + np.maximum(t - ramp, 0.0))
            )
            cos, sin = np.cos(path.place[:, 2]), np.sin(path.place[:, 2])
            path.velocity[:, 0] = cos * velocity[:, 0] + sin * velocity[:, 1]
            path.velocity[:, 1] = cos * velocity[:, 1] - sin * velocity[:, 0]
            path.velocity[:, 2] = velocity[:, 2]
