"""Arm motion: the moves of a plan as trapezoidal velocity profiles in closed form.

With t the time since a move began (s)::

    V = speed clip(min(t - rest, seconds - t) / ramp, 0, 1)            ramp = speed / acceleration (s)
    F = F0 + (F1 - F0) u^2 (3 - 2 u),  u = clip(t / settle, 0, 1)      normal force (N)
    P = 4 tap u (1 - u),               u = clip((t - rest) / 10 ms, 0, 1)   external force (N)

V is along the direction of the move (m/s) or, for a rotation, about the fingertip's normal at the TCP
(rad/s).

The fingertip faces down: at yaw 0 its x axis is that of the base, its y and z axes are opposite to the
base's. At yaw q about its normal, its rotation vector is pi (cos q/2, -sin q/2, 0).
"""

import math
from typing import Final, TypeVar

import numpy as np

from connectors.sim.scene import Move, Sampler, Scene
from operators.batch import Motion, Reals, s

Value = TypeVar("Value", float, Reals)

TAP_DURATION: Final = 0.01  # s
SPIN_ACCELERATION: Final = 10.0  # rad/s2, at the ends of a rotation
CONTROLLER_UPTIME: Final = 3600.0  # s at the beginning of a run


class PlannedArm:
    """An arm that executes the plan of a scene once; `seed` is that of the plan."""

    def __init__(self, scene: Scene, seed: int) -> None:
        self._acceleration, self._moves = scene.acceleration, scene.moves(seed)
        self._next = next(self._moves, None)  # current move with its start (s); None after the plan
        self._pose, self._force = (0.0, 0.0, 0.0), 0.0  # m, m, rad and N at its start

    def at(self, times: Reals) -> tuple[Reals, Reals]:
        """Return the trajectory at increasing instants (k,) (s); shorter if the plan ends before the last.

        Returns:
            Drive (k, 6): velocity (m/s, m/s, rad/s), normal force (N) and external force (N, N), in the
            fingertip's frame. Pose (k, 3) m, m, rad of the TCP, relative to its start, seen along the normal.
        """
        k, done = len(times), 0
        drive, pose = np.zeros((k, 6)), np.zeros((k, 3))
        while self._next is not None:
            start, move = self._next
            until = int(times.searchsorted(start + move.seconds))
            if until > done:
                self._follow(move, times[done:until] - start, drive[done:until], pose[done:until])
                done = until
            if done == k:
                break
            self._pose = self._displaced(move, move.speed * (move.seconds - move.rest - self._ramp(move)))
            self._force = self._force if move.force is None else move.force
            self._next = next(self._moves, None)
        return drive[:done], pose[:done]

    def _ramp(self, move: Move) -> float:
        """Return the time (s) in which a move reaches its speed."""
        acceleration = SPIN_ACCELERATION if move.motion == "rotation" else self._acceleration
        return min(abs(move.speed) / acceleration, (move.seconds - move.rest) / 2)

    def _displaced(self, move: Move, travel: Value) -> tuple[Value | float, Value | float, Value | float]:
        """Return the pose (m, m, rad) after a part of a move (m or rad)."""
        x, y, yaw = self._pose
        if move.motion == "rotation":
            return x, y, yaw + travel
        onward = math.radians(move.direction_deg) + yaw
        return x + travel * math.cos(onward), y + travel * math.sin(onward), yaw

    def _follow(self, move: Move, t: Reals, drive: Reals, pose: Reals) -> None:
        """Write the trajectory at times (k,) (s since the move began) to `drive`, now 0, and `pose`."""
        heading, pose[:] = math.radians(move.direction_deg), self._pose
        along = math.cos(heading), math.sin(heading)
        if move.speed:
            ramp = self._ramp(move)
            up, down = np.clip((t - move.rest) / ramp, 0, 1), np.clip((move.seconds - t) / ramp, 0, 1)
            cruise = np.clip(t - move.rest - ramp, 0, move.seconds - move.rest - 2 * ramp)
            speed = move.speed * np.minimum(up, down)
            travel = move.speed * (ramp * up * up / 2 + cruise + ramp * (1 - down * down) / 2)
            if move.motion == "rotation":
                drive[:, 2] = speed
            else:
                drive[:, 0], drive[:, 1] = speed * along[0], speed * along[1]
            pose[:, 0], pose[:, 1], pose[:, 2] = self._displaced(move, travel)
        drive[:, 3] = self._force
        if move.force is not None:
            u = np.clip(t / move.settle, 0, 1)
            drive[:, 3] = self._force + (move.force - self._force) * u * u * (3 - 2 * u)
        if move.tap:
            u = np.clip((t - move.rest) / TAP_DURATION, 0, 1)
            push = 4 * move.tap * u * (1 - u)
            drive[:, 4], drive[:, 5] = push * along[0], push * along[1]


def in_base(drive: Reals, pose: Reals) -> tuple[Reals, Reals]:
    """Return velocity and pose of the TCP in the base frame: (k, 6) m/s, rad/s and (k, 6) m, rad."""
    x, y, yaw = pose.T
    vx, vy, spin = drive[:, :3].T
    cos, sin, zero = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)
    velocity = [cos * vx - sin * vy, -sin * vx - cos * vy, zero, zero, zero, -spin]
    rotated = [x, -y, zero, math.pi * np.cos(yaw / 2), -math.pi * np.sin(yaw / 2), zero]
    return np.stack(velocity, axis=1), np.stack(rotated, axis=1)


class Controller:
    """Controller of the arm, which reports motion samples."""

    def __init__(self, scene: Scene, seed: int) -> None:
        self._arm = PlannedArm(scene, seed)
        self._sampler = Sampler(scene.motion, np.random.default_rng([seed, 1]))

    def take(self, samples: int) -> Motion | None:
        """Return the next samples, timestamped from the run's start; fewer at the plan's end, then None."""
        t = self._sampler.instants(samples)  # (k,) s
        velocity, pose = in_base(*self._arm.at(t))
        if not len(velocity):
            return None
        t = t[: len(velocity)]
        time, arrive = self._sampler.stamp(len(t))
        stamps = CONTROLLER_UPTIME + t  # s
        motion = Motion(time, np.rint(stamps * s).astype(np.int64), velocity, pose)
        return motion if arrive.all() else motion[arrive]
