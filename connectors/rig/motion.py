"""The arm: a plan's moves as trapezoids of velocity, in closed form, at any instants.

With t the time since a move began (s)::

    V = speed clip(min(t - rest, seconds - t) / ramp, 0, 1)            ramp = speed / acceleration (s)
    F = F0 + (F1 - F0) u^2 (3 - 2 u),  u = clip(t / settle, 0, 1)      normal force (N)
    P = 4 tap u (1 - u),               u = clip((t - rest) / 10 ms, 0, 1)   push from outside (N)

V is along the move's direction (m/s) or, in a rotation, about the fingertip's normal through the TCP (rad/s).

The fingertip looks down: at yaw 0 its x is the base's x, its y and z are opposite to the base's. Turned by
yaw q about its normal, its rotation vector is pi (cos q/2, -sin q/2, 0).
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from connectors.rig.scene import Move, Scene
from connectors.rig.timing import Sampler
from operators.batch import Motion, Reals, s

TAP: Final = 0.01  # s
CONTROLLER_START: Final = 3600.0  # s that the controller had been up when the run began


@dataclass(frozen=True, slots=True)
class Path:
    """Where the arm is, how it moves and how hard it presses at k instants."""

    velocity: Reals  # (k, 3) m/s, m/s, rad/s of the TCP in the fingertip's frame
    place: Reals  # (k, 3) m, m, rad of the TCP, seen along the normal from where it began
    force: Reals  # (k,) N
    push: Reals  # (k, 2) N in the fingertip's frame

    @classmethod
    def blank(cls, k: int) -> "Path":
        """Nothing yet, at k instants."""
        return cls(np.zeros((k, 3)), np.zeros((k, 3)), np.zeros(k), np.zeros((k, 2)))

    def __getitem__(self, rows: slice) -> "Path":
        """A view of some of the instants."""
        return Path(self.velocity[rows], self.place[rows], self.force[rows], self.push[rows])


class Arm:
    """Follows a scene's plan once, from its beginning.

    Args:
        scene: The scene.
        seed: What the plan draws from.
        begun: Told of every move when it begins, with its start (s).
    """

    def __init__(self, scene: Scene, seed: int, begun: Callable[[Move, float], None] | None = None) -> None:
        self._moves: Iterator[Move] = scene.plan.moves(np.random.default_rng([seed, 0]))
        self._scene, self._begun = scene, begun
        self._move: Move | None = None
        self._start = self._end = 0.0  # s, of the move
        self._place = np.zeros(3)  # m, m, rad at its start
        self._force = (0.0, 0.0)  # N, at its start and after it has settled
        self._next()

    def _next(self) -> None:
        if (last := self._move) is not None:
            end = Path.blank(1)
            self._follow(last, np.array([last.seconds]), end)
            self._place = end.place[0]
        self._move = move = next(self._moves, None)
        self._start = self._end
        if move is not None:
            self._end += move.seconds
            before = self._force[1]
            self._force = (before, before if move.force is None else move.force)
            if self._begun is not None:
                self._begun(move, self._start)

    def at(self, times: Reals) -> Path:
        """The path at instants (k,) (s) that never go back; shorter where the plan ends before the last."""
        k, done = len(times), 0
        path = Path.blank(k)
        while (move := self._move) is not None:
            until = int(np.searchsorted(times, self._end))
            if until > done:
                self._follow(move, times[done:until] - self._start, path[done:until])
                done = until
            if done == k:
                break
            self._next()
        return path[:done]

    def _follow(self, move: Move, t: Reals, path: Path) -> None:
        """Fill in the path of one move at instants (k,) since it began."""
        path.place[:] = self._place
        heading = math.radians(move.direction_deg)
        along = math.cos(heading), math.sin(heading)
        if move.speed:
            spins = move.motion == "rotation"
            acceleration = self._scene.spin_acceleration if spins else self._scene.acceleration
            ramp = min(abs(move.speed) / acceleration, (move.seconds - move.rest) / 2)
            up = np.clip((t - move.rest) / ramp, 0.0, 1.0)
            down = np.clip((move.seconds - t) / ramp, 0.0, 1.0)
            cruise = np.clip(t - move.rest - ramp, 0.0, move.seconds - move.rest - 2 * ramp)
            speed = move.speed * np.minimum(up, down)
            travel = move.speed * (ramp * up * up / 2 + cruise + ramp * (1.0 - down * down) / 2)
            if spins:
                path.velocity[:, 2] = speed
                path.place[:, 2] += travel
            else:
                yaw = self._place[2]
                path.velocity[:, 0], path.velocity[:, 1] = speed * along[0], speed * along[1]
                path.place[:, 0] += travel * math.cos(heading + yaw)
                path.place[:, 1] += travel * math.sin(heading + yaw)
        if move.tap:
            u = np.clip((t - move.rest) / TAP, 0.0, 1.0)
            path.push[:] = np.multiply.outer(4 * move.tap * u * (1 - u), along)
        first, last = self._force
        path.force[:] = last
        if first != last:
            u = np.clip(t / move.settle, 0.0, 1.0)
            path.force[:] = first + (last - first) * u * u * (3 - 2 * u)


def in_base(path: Path) -> tuple[Reals, Reals]:
    """Velocity and pose of the TCP in the robot's base frame: (k, 6) m/s, rad/s and (k, 6) m, rad."""
    x, y, yaw = path.place.T
    vx, vy, spin = path.velocity.T
    cos, sin, nought = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)
    velocity = [cos * vx - sin * vy, -sin * vx - cos * vy, nought, nought, nought, -spin]
    pose = [x, -y, nought, math.pi * np.cos(yaw / 2), -math.pi * np.sin(yaw / 2), nought]
    return np.stack(velocity, axis=1), np.stack(pose, axis=1)


class Controller:
    """What the arm's controller says of its own motion, a stretch at a time."""

    def __init__(self, scene: Scene, seed: int) -> None:
        self._arm = Arm(scene, seed)
        self._sampler = Sampler(scene.motion, np.random.default_rng([seed, 1]))

    def take(self, samples: int) -> Motion | None:
        """The next samples, stamped from the run's start; fewer where the plan ends, None after it."""
        t = self._sampler.instants(samples)  # (k,) s
        velocity, pose = in_base(self._arm.at(t))
        if not len(velocity):
            return None
        t = t[: len(velocity)]
        time, arrive = self._sampler.stamp(len(t))
        stamps = CONTROLLER_START + t * (1 + self._sampler.timing.drift)  # s
        motion = Motion(time, np.rint(stamps * s).astype(np.int64), velocity, pose)
        return motion if arrive.all() else motion[arrive]
