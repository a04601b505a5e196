"""Arm of the simulated scene, which `collect --virtual` drives in its own process, without a controller.

It moves exactly as planned, with linear ramps of speed, and presses the fingertip onto the surface; it stops
at once. It does not have the wire protocol of a robot. Its coordinates are those of the fingertip that just
touches the middle of the surface: x right, y up, z into the surface, yaw about z::

    F = k max(0, z - drop(x, y))         normal force (N), k `STIFFNESS`
"""

import logging
from bisect import bisect_right
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from connectors.sim.scene import Scene, Travel, surface_drop
from connectors.sim.simulated_rig import SENSOR, SimulatedSource, ticks
from connectors.ur.ur_state import ArmState, Bounds, Pose, offset_pose
from operators.batch import Motion, Reals, Touch, s
from operators.errors import EndpointError
from operators.ports import Clock
from operators.rotation import quaternion, rotate, rotation_difference

log = logging.getLogger("slipflow")

STIFFNESS: Final = 1000.0  # N/m of fingertip, arm and surface in series; assumed
HEIGHT: Final = 0.02  # m, initial height above the middle of the surface
STEP: Final = 0.008  # s between checks of the state, as of a controller with 125 Hz
NAME: Final = "virtual arm"
_TICK: Final = 1e-9  # s, resolution of the clock
_SHORTEST: Final = 1e-12  # m, rad; a leg of length 0 has no direction


@dataclass(frozen=True, slots=True)
class Ride:
    """Motion along a polyline, from rest to rest; its distance is that of the rotation where it is longer."""

    corners: Reals  # (n, 4) m, m, m, rad: x, y, z, yaw
    start: float = 0.0  # s
    speed: float = 1.0  # m/s or rad/s
    acceleration: float = 1.0  # m/s2 or rad/s2

    @property
    def distances(self) -> Reals:
        """Distance (n,) from the first corner to each."""
        legs = np.diff(self.corners, axis=0)
        longer = np.maximum(np.linalg.norm(legs[:, :3], axis=1), np.abs(legs[:, 3]))
        return np.concatenate([[0.0], np.cumsum(longer)])

    @property
    def travel(self) -> Travel:
        """Motion over the whole distance."""
        return Travel(self.start, max(self.distances[-1], _SHORTEST), self.speed, self.acceleration)

    def at(self, times: Reals) -> tuple[Reals, Reals]:
        """Return place and velocity (k, 4) at instants (k,) (s)."""
        (distance, speed), corners = self.travel.at(times), self.distances
        leg = np.clip(corners.searchsorted(distance, "right") - 1, 0, len(corners) - 2)
        along = np.diff(self.corners, axis=0) / np.maximum(np.diff(corners), _SHORTEST)[:, None]
        place = self.corners[leg] + (distance - corners[leg])[:, None] * along[leg]
        return place, speed[:, None] * along[leg]


class SimulatedArm:
    """Arm over the surface of a scene, with fingertips; with the moves of `connectors.ur.ur_arm.UrArm`.

    Args:
        scene: Surface, vibration and physics; its plan is not used.
        surface: Pose of the TCP at which the fingertip just touches the middle of the surface.
        bounds: Workspace and force limit.
        clock: Clock of the moves and of the samples.
        seed: Random seed of the fingertips; the same seed and the same moves give identical samples.
        fingers: Fingertips that share the motion.

    Attributes:
        fault: Reason why the arm was stopped; empty if it was not.
        fingertips: Source of their samples.
        motion: Source of the arm's motion.
    """

    def __init__(
        self,
        scene: Scene,
        surface: Pose,
        bounds: Bounds,
        clock: Clock,
        *,
        seed: int = 0,
        fingers: tuple[int, ...] = (0,),
    ) -> None:
        from connectors.sim.finger import Finger

        self.bounds, self.fault = bounds, ""
        self._curvatures, self._surface = scene.curvatures, surface
        self._clock, self._origin = clock, clock.now()
        above = np.array([0.0, 0.0, -HEIGHT, 0.0])
        self._rides = [Ride(np.array([above, above]))]
        self._fingertips = [Finger(scene, seed, each, self) for each in fingers]
        self.fingertips = SimulatedSource(
            "VirtualTouch", Touch, self._touch, {"sensor": SENSOR}, fingers=fingers, rate=100.0
        )
        self.motion = SimulatedSource("VirtualMotion", Motion, self._motion, {"arm": "simulated"})

    async def __aenter__(self) -> Self:
        """Check the initial state.

        Raises:
            EndpointError: if the arm is out of bounds.
        """
        self._check()
        return self

    async def __aexit__(self, *_: object) -> None:
        self._halt()

    @property
    def state(self) -> ArmState:
        """State at the clock's time."""
        return self.state_at(self._now())

    def state_at(self, instant: float) -> ArmState:
        """Return the state at an instant (s since the start)."""
        place, velocity, force = (each[0].tolist() for each in self._states(np.array([instant])))
        turned = quaternion(self._surface[3:])
        linear, angular = rotate(tuple(velocity[:3]), turned), rotate((0.0, 0.0, velocity[3]), turned)
        pose = offset_pose(self._surface, tuple(place[:3]), place[3])
        return ArmState(pose, (*linear, *angular), rotate((0.0, 0.0, -force), turned))

    def at(self, times: Reals) -> tuple[Reals, Reals]:
        """Return drive (k, 6) and pose (k, 3) at increasing instants (k,) (s); see `PlannedArm.at`."""
        place, velocity, force = self._states(times)
        drive = np.zeros((len(times), 6))
        cos, sin = np.cos(place[:, 3]), np.sin(place[:, 3])
        drive[:, 0] = cos * velocity[:, 0] + sin * velocity[:, 1]
        drive[:, 1] = cos * velocity[:, 1] - sin * velocity[:, 0]
        drive[:, 2], drive[:, 3] = velocity[:, 3], force
        return drive, place[:, [0, 1, 3]]

    async def line(self, poses: Sequence[Pose], speed: float, acceleration: float, seconds: float) -> None:
        """Move along straight lines through poses, and stop at the last.

        Raises:
            EndpointError: if the arm had to be stopped.
        """
        del seconds
        for pose in poses:
            if reason := self.bounds.violation(ArmState(pose, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))):
                self.fail(f"target outside the bounds: {reason}")
        await self._follow([*map(self._local, poses)], speed, acceleration)

    async def turn(self, spin: float, seconds: float, acceleration: float) -> None:
        """Rotate about the TCP's own z (rad/s) for a time (s), then come to rest.

        Raises:
            EndpointError: if the arm had to be stopped.
        """
        angle = spin * seconds * min(1.0, seconds * acceleration / abs(spin))
        await self._follow([self._place + np.array([0.0, 0.0, 0.0, angle])], abs(spin), acceleration)

    async def wait(self, seconds: float) -> None:
        """Wait while the arm continues its motion.

        Raises:
            EndpointError: if the arm had to be stopped.
        """
        end = self._now() + seconds
        self._check()
        while (left := end - self._now()) > _TICK:
            await self._clock.sleep_until(self._clock.now() + round(min(left, STEP) * s))
            self._check()

    def fail(self, reason: str) -> None:
        """Stop the arm permanently; the current move and all later ones raise this reason."""
        if not self.fault:
            self.fault = reason
            log.error("%s is stopped: %s", NAME, reason)
            self._halt()

    async def _touch(self, clock: Clock) -> AsyncIterator[Touch]:
        """Yield a sample of each fingertip every 10 ms; a late one shows the instant at which it was due."""
        async for time in ticks(clock, self._origin, s // 100):
            for fingertip in self._fingertips:
                sample, _ = fingertip.sense((time - self._origin) / s)
                yield sample.later(self._origin)

    async def _motion(self, clock: Clock) -> AsyncIterator[Motion]:
        """Yield a sample every 8 ms; the controller's clock shows the time since the arm was created."""
        async for time in ticks(clock, self._origin, round(STEP * s)):
            state = self.state_at((time - self._origin) / s)
            stamp = np.array([time - self._origin])
            yield Motion(np.array([time]), stamp, np.array([state.velocity]), np.array([state.pose]))

    @property
    def _place(self) -> Reals:
        place: Reals = self._states(np.array([self._now()]))[0][0]
        return place

    def _now(self) -> float:
        return (self._clock.now() - self._origin) / s

    def _local(self, pose: Pose) -> Reals:
        """Return the coordinates (4,) of a pose; the arm cannot tilt, so only its yaw counts."""
        offset = pose[0] - self._surface[0], pose[1] - self._surface[1], pose[2] - self._surface[2]
        w, x, y, z = quaternion(self._surface[3:])
        back = w, -x, -y, -z  # from the base frame to that of the surface
        turn = rotation_difference(self._surface[3:], pose[3:])
        return np.array([*rotate(offset, back), rotate(turn, back)[2]])

    def _states(self, times: Reals) -> tuple[Reals, Reals, Reals]:
        """Return place (k, 4), velocity (k, 4) and normal force (k,) at increasing instants (k,) (s)."""
        place, velocity = np.zeros((2, len(times), 4))
        if len(times):
            first = bisect_right(self._rides, times[0], key=lambda ride: ride.start) - 1
            rides = self._rides[first:]
            cuts = [0, *np.searchsorted(times, [ride.start for ride in rides[1:]]), len(times)]
            for number, ride in enumerate(rides):
                part = slice(cuts[number], cuts[number + 1])
                place[part], velocity[part] = ride.at(times[part])
        drop = [surface_drop(self._curvatures, x, y) for x, y in place[:, :2].tolist()]  # (k,) m
        return place, velocity, STIFFNESS * np.maximum(0.0, place[:, 2] - drop)

    async def _follow(self, corners: Sequence[Reals], speed: float, acceleration: float) -> None:
        """Move from the present place along corners (4,) to the last one."""
        self._check()
        now = self._now()
        ride = Ride(np.array([self._place, *corners]), now, speed, acceleration)
        self._rides.append(ride)
        await self.wait(ride.travel.end - now)

    def _halt(self) -> None:
        """Stand still from now on."""
        self._rides.append(Ride(np.array([self._place, self._place]), self._now()))

    def _check(self) -> None:
        if not self.fault and (reason := self.bounds.violation(self.state)):
            self.fail(reason)
        if self.fault:
            raise EndpointError(NAME, self.fault)


def start_pose(surface: Pose) -> Pose:
    """Return the pose in which the arm starts, above a surface."""
    return offset_pose(surface, (0.0, 0.0, -HEIGHT))
