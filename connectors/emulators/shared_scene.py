"""The lab: one simulated scene on the host's clock, for emulators to serve over the devices' own protocols.

Where a `SimulatedRig` gives samples on its own schedule, the lab is asked: a barometer converts when told to,
a controller looks at its arm when its cycle comes. All who ask share one arm, so that the fingertip is
dragged by the motion that is reported and commanded.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from threading import Lock
from time import time_ns
from typing import Final

import numpy as np

from connectors.sim.arm_motion import Arm, in_base
from connectors.sim.commanded_motion import CommandQueue
from connectors.sim.scene import Scene, commanded_scene
from operators.batch import Commands, Counts, Reals, Touch, Truth, concat, s
from operators.errors import ParameterError

STRETCH: Final = s // 2  # ns of the scene at a time, when nobody has asked for long


class SharedScene:
    """A scene that begins when the lab is built, and goes on as fast as the host's clock.

    It may be asked from any thread. Its first fingertip in a process takes seconds to build, while the
    physics is compiled.

    Args:
        scene: What happens; the default is an arm that stands still in the air until it is commanded, and
            cells with the noise of real ones. `Scene()` presses and strokes until it is commanded.
        seed: Of the plan, of the cells' individuality and of all noise.
        fingers: Fingertips that feel the same motion, each with noise and cells of its own.
        now: The host's clock, ns since 1970 UTC; emulators stamp with it.
        remember: Seconds that `truth` reaches back, at least.

    Raises:
        ParameterError: if there is no fingertip.
    """

    def __init__(
        self,
        scene: Scene | None = None,
        seed: int = 0,
        *,
        fingers: tuple[int, ...] = (0,),
        now: Callable[[], int] = time_ns,
        remember: float = 600.0,
    ) -> None:
        if not fingers:
            raise ParameterError("SharedScene", "fingers", fingers, "at least one fingertip")
        from connectors.sim.finger import Finger, compile_physics  # noqa: PLC0415 - loads numba: only to run

        compile_physics()
        self.scene = scene if scene is not None else commanded_scene()
        self.seed, self.fingers, self.now = seed, fingers, now
        self._lock, self.orders = Lock(), CommandQueue()
        self._skin = {finger: Finger(self.scene, seed, finger, orders=self.orders) for finger in fingers}
        self._arm = Arm(self.scene, seed, orders=self.orders)
        self._least = round(self.scene.parameters.step * s)  # ns between two readings that differ
        rows = max(1, int(remember * self.scene.touch.rate))
        self._truth = {finger: deque[Truth](maxlen=rows) for finger in fingers}  # a row each
        self._newest: dict[int, Touch] = {}  # by fingertip, stamped from the beginning
        self._ended: set[int] = set()  # fingertips whose plan has ended
        self._seen = -1  # ns, from the beginning, of the newest motion
        self._pose, self._velocity = np.zeros(6), np.zeros(6)
        self._origin = now()
        self.orders.begin(self._origin)
        for finger in fingers:
            self._reach(finger, 0)

    def touch(self, finger: int, time: int) -> tuple[Counts, Counts]:
        """What the cells of a fingertip convert at an instant.

        Args:
            finger: One of `fingers`.
            time: Of the start of the conversion, ns. The scene never goes back: an instant before the newest
                that was asked for (or less than a step of the physics after it) gives the newest reading.

        Returns:
            Raw ADC counts of pressure and of temperature, (6,) each; both 0 of a cell that the scene declares
            dead. They repeat once the plan has ended.
        """
        with self._lock:
            self._reach(finger, max(0, time - self._origin))
            newest = self._newest[finger]
            return newest.counts[0], newest.temperature[0] * newest.valid[0]

    def motion(self, time: int) -> tuple[Reals, Reals]:
        """Where the TCP really is at an instant (ns) that never goes back, as in `touch`, and how it moves.

        Returns:
            Pose, (6,) m and rotation vector in rad, and velocity, (6,) m/s and rad/s, in the base frame. Once
            the plan has ended the arm stands still.
        """
        with self._lock:
            instant = max(0, time - self._origin)
            if instant > self._seen:
                self._seen = instant
                path = self._arm.at(np.array([instant / s]))
                if len(path):
                    velocity, pose = in_base(path)
                    self._pose, self._velocity = pose[0], velocity[0]
                else:
                    self._velocity = np.zeros(6)
            return self._pose.copy(), self._velocity.copy()

    def command(self, commands: Commands) -> None:
        """Obey from the commands' own times on; what has already been felt or looked at stays as it was."""
        with self._lock:
            self.orders.give(commands)
            passed = min(self._seen, *(int(newest.time[0]) for newest in self._newest.values()))
            self.orders.forget(self._origin + passed - 2 * self._least)

    def advance(self, time: int) -> None:
        """Bring all fingertips up to an instant (ns), unless they are there.

        A server calls it now and then, so that who asks after an hour of silence need not wait for the hour
        to be simulated.
        """
        with self._lock:
            for finger in self.fingers:
                self._reach(finger, max(0, time - self._origin))

    def truth(self, finger: int | None = None) -> Truth:
        """What really happened to a fingertip (the first one) whenever it was asked what it felt."""
        with self._lock:
            truth = concat(Truth, self._truth[self.fingers[0] if finger is None else finger])
            return replace(truth, time=truth.time + self._origin)

    def _reach(self, finger: int, instant: int) -> None:
        """Have a fingertip feel all up to an instant (ns since the beginning)."""
        newest = self._newest.get(finger)
        felt = -self._least if newest is None else int(newest.time[0])
        while instant - felt >= self._least and finger not in self._ended:
            felt = min(instant, felt + STRETCH)
            if (sensed := self._skin[finger].sense(felt / s)) is None:
                self._ended.add(finger)
                return
            self._newest[finger], truth = sensed
            self._truth[finger].append(truth)
