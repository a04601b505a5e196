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
from typing import Final, NamedTuple

import numpy as np

from connectors.sim.contact import compiled
from connectors.sim.scene import Move, Sampler, Scene
from operators.batch import Motion, Reals, s

TAP_DURATION: Final = 0.01  # s
SPIN_ACCELERATION: Final = 10.0  # rad/s2, at the ends of a rotation
CONTROLLER_UPTIME: Final = 3600.0  # s at the beginning of a run


class Course(NamedTuple):
    """Constants of one move."""

    start: float  # s
    seconds: float
    rest: float  # s
    ramp: float  # s
    speed: float  # m/s or, of a rotation, rad/s
    spins: bool
    along: tuple[float, float]  # unit vector of the direction, in the fingertip's frame
    onward: tuple[float, float]  # unit vector of the direction, in the frame of the pose
    pose: tuple[float, float, float]  # m, m, rad at the start
    end: tuple[float, float, float]  # m, m, rad at the end
    tap: float  # N
    settle: float  # s
    first: float  # N at the start
    last: float  # N after settling


def course(move: Move, start: float, pose: tuple[float, float, float], force: float, scene: Scene) -> Course:
    """Return the course of a move from `start` (s), an initial pose (m, m, rad) and force (N)."""
    heading, spins = math.radians(move.direction_deg), move.motion == "rotation"
    acceleration = SPIN_ACCELERATION if spins else scene.acceleration
    ramp = min(abs(move.speed) / acceleration, (move.seconds - move.rest) / 2)
    onward = math.cos(heading + pose[2]), math.sin(heading + pose[2])
    travel = move.speed * (move.seconds - move.rest - ramp)
    return Course(
        start=start,
        seconds=move.seconds,
        rest=move.rest,
        ramp=ramp,
        speed=move.speed,
        spins=spins,
        along=(math.cos(heading), math.sin(heading)),
        onward=onward,
        pose=pose,
        end=(
            (pose[0], pose[1], pose[2] + travel)
            if spins
            else (pose[0] + travel * onward[0], pose[1] + travel * onward[1], pose[2])
        ),
        tap=move.tap,
        settle=move.settle,
        first=force,
        last=force if move.force is None else move.force,
    )


@compiled
def follow(course: Course, times: Reals, drive: Reals, pose: Reals) -> None:
    """Write the trajectory of a course at instants (k,) (s) to `drive` (k, 6), initially 0, and `pose`."""
    for i in range(times.size):
        t = times[i] - course.start
        pose[i, 0], pose[i, 1], pose[i, 2] = course.pose
        if course.speed != 0.0:
            up = min(max((t - course.rest) / course.ramp, 0.0), 1.0)
            down = min(max((course.seconds - t) / course.ramp, 0.0), 1.0)
            longest = course.seconds - course.rest - 2 * course.ramp
            cruise = min(max(t - course.rest - course.ramp, 0.0), longest)
            speed = course.speed * min(up, down)
            travel = course.speed * (
                course.ramp * up * up / 2 + cruise + course.ramp * (1.0 - down * down) / 2
            )
            if course.spins:
                drive[i, 2] = speed
                pose[i, 2] += travel
            else:
                drive[i, 0], drive[i, 1] = speed * course.along[0], speed * course.along[1]
                pose[i, 0] += travel * course.onward[0]
                pose[i, 1] += travel * course.onward[1]
        drive[i, 3] = course.last
        if course.first != course.last:
            u = min(max(t / course.settle, 0.0), 1.0)
            drive[i, 3] = course.first + (course.last - course.first) * u * u * (3 - 2 * u)
        if course.tap != 0.0:
            u = min(max((t - course.rest) / TAP_DURATION, 0.0), 1.0)
            push = 4 * course.tap * u * (1 - u)
            drive[i, 4], drive[i, 5] = push * course.along[0], push * course.along[1]


class PlannedArm:
    """An arm that executes the plan of a scene once; `seed` is that of the plan."""

    def __init__(self, scene: Scene, seed: int) -> None:
        self._scene, self._moves = scene, scene.moves(seed)
        self._course = self._next((0.0, 0.0, 0.0), 0.0)  # current move; None after the plan

    def _next(self, pose: tuple[float, float, float], force: float) -> Course | None:
        """Begin the next move at a pose (m, m, rad) and a force (N)."""
        for start, move in self._moves:
            return course(move, start, pose, force, self._scene)
        return None

    def at(self, times: Reals) -> tuple[Reals, Reals]:
        """Return the trajectory at increasing instants (k,) (s); shorter if the plan ends before the last.

        Returns:
            Drive (k, 6): velocity (m/s, m/s, rad/s), normal force (N) and external force (N, N), in the
            fingertip's frame. Pose (k, 3) m, m, rad of the TCP, relative to its start, seen along the normal.
        """
        k, done = len(times), 0
        drive, pose = np.zeros((k, 6)), np.zeros((k, 3))
        while (course := self._course) is not None:
            until = int(times.searchsorted(course.start + course.seconds))
            if until > done:
                follow(course, times[done:until], drive[done:until], pose[done:until])
                done = until
            if done == k:
                break
            self._course = self._next(course.end, course.last)
        return drive[:done], pose[:done]


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
        stamps = CONTROLLER_UPTIME + t * (1 + self._sampler.timing.drift)  # s
        motion = Motion(time, np.rint(stamps * s).astype(np.int64), velocity, pose)
        return motion if arrive.all() else motion[arrive]
