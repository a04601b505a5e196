"""Simulated scene on the host's clock, shared by the emulated devices.

`SimulatedRig` produces samples on its own schedule; this scene responds to requests: a barometer converts
when its host starts a conversion, a controller reads the arm in each of its cycles. All devices share one
arm, so the motion that the controller reports is the motion of the fingertip.
"""

from collections.abc import Callable
from threading import Lock
from time import time_ns
from typing import Final

import numpy as np

from connectors.sim.commanded_motion import CommandedArm
from connectors.sim.scene import Scene, commanded_scene
from operators.batch import Commands, Counts, Reals, Touch, Truth, s
from operators.errors import ParameterError

LONGEST_STEP: Final = s // 2  # ns, simulated at a time when the scene has been idle for longer


class SharedScene:
    """A thread-safe scene that starts when it is created and follows the host's clock.

    The first scene in a process takes seconds to create, because the physics is compiled.

    Args:
        scene: Scene to simulate (default `commanded_scene()`).
        seed: Random seed; the same seed and the same requests give identical output.
        fingers: Fingertips that share one motion, each with its own noise and cells.
        height: Initial height of the arm above the middle of the surface (m, default 0).
        now: Clock of the host (ns since 1970 UTC), also used by the emulators for timestamps.

    Raises:
        ParameterError: if there is no fingertip.
    """

    def __init__(
        self,
        scene: Scene | None = None,
        seed: int = 0,
        *,
        fingers: tuple[int, ...] = (0,),
        height: float = 0.0,
        now: Callable[[], int] = time_ns,
    ) -> None:
        if not fingers:
            raise ParameterError("SharedScene", "fingers", fingers, "at least one fingertip")
        from connectors.sim.finger import Finger, compile_physics  # noqa: PLC0415 - loads numba: only to run

        compile_physics()
        self.scene = scene if scene is not None else commanded_scene()
        self.fingers, self.now = fingers, now
        self._lock, self.origin = Lock(), now()
        self._arm = CommandedArm(self.scene, self.origin, height)
        self._fingertips = {finger: Finger(self.scene, seed, finger, self._arm) for finger in fingers}
        self._step = round(self.scene.parameters.step * s)  # ns, one physics step
        self._latest: dict[int, Touch] = {}  # by fingertip, time in ns from the origin
        self._latest_motion = -1  # ns from the origin
        self._pose, self._velocity = np.zeros(6), np.zeros(6)
        self._push = 0.0  # N, of the surface at the latest motion
        for finger in fingers:
            self._simulate(finger, 0)

    def touch(self, finger: int, time: int) -> tuple[Counts, Counts]:
        """Return the counts of a conversion that starts at `time` (ns).

        The latest reading is returned for an instant before the latest request, or less than one physics step
        after it.

        Returns:
            Raw ADC counts of pressure and of temperature, (6,) each; 0 for dead cells of the scene.
        """
        with self._lock:
            self._simulate(finger, max(0, time - self.origin))
            latest = self._latest[finger]
            return latest.counts[0], latest.temperature[0] * latest.valid[0]

    def motion(self, time: int) -> tuple[Reals, Reals]:
        """Return the true motion of the TCP at `time` (ns); the latest motion for an earlier instant.

        Returns:
            Pose, (6,) m and rotation vector in rad, and velocity, (6,) m/s and rad/s, in the base frame.
        """
        with self._lock:
            instant = max(0, time - self.origin)
            if instant > self._latest_motion:
                self._latest_motion = instant
                self._pose, self._velocity, self._push = self._arm.motion(instant / s)
            return self._pose.copy(), self._velocity.copy()

    @property
    def wrench(self) -> Reals:
        """Force (N) and torque (N m) of the surface on the tool at the latest motion, (6,), base frame.

        Friction and torque are not modelled.
        """
        return np.array([0.0, 0.0, self._push, 0.0, 0.0, 0.0])

    def command(self, commands: Commands) -> None:
        """Apply commands from their own times on; they cannot change what is already simulated."""
        with self._lock:
            self._arm.add(commands)
            passed = min(self._latest_motion, *(int(latest.time[0]) for latest in self._latest.values()))
            self._arm.forget((passed - 2 * self._step) / s)

    def advance(self, time: int) -> None:
        """Simulate all fingertips up to `time` (ns), so that the next request is fast."""
        with self._lock:
            for finger in self.fingers:
                self._simulate(finger, max(0, time - self.origin))

    def _simulate(self, finger: int, instant: int) -> None:
        """Simulate a fingertip up to an instant (ns from the origin)."""
        latest = self._latest.get(finger)
        done = -self._step if latest is None else int(latest.time[0])
        while instant - done >= self._step:
            done = min(instant, done + LONGEST_STEP)
            self._latest[finger] = self._sense(finger, done / s)[0]

    def _sense(self, finger: int, instant: float) -> tuple[Touch, Truth]:
        return self._fingertips[finger].sense(instant)
