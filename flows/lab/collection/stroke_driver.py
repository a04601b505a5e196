"""Driver of an arm through the strokes of a series; it is the source of their episodes."""

import asyncio
import math
from collections.abc import AsyncIterator, Mapping, Sequence
from typing import Final, Protocol, Self

import numpy as np

from connectors.ur.ur_state import ArmState, Pose
from flows.lab.collection.arm_path import Line, Step, Turn, Wait
from flows.lab.collection.contact_monitor import ContactMonitor
from flows.lab.collection.stroke_plan import Stroke, StrokeSeries
from operators.batch import MOTIONS, SURFACES, Episodes
from operators.ports import Clock, Description, Json, Source

_POLL: Final = 0.05  # s


class Arm(Protocol):
    """Arm that makes one move at a time: `UrArm` or `SimulatedArm`, which document the moves.

    Entering its context opens it, leaving stops it. The moves raise EndpointError if it had to be stopped.
    """

    fault: str  # reason why it was stopped; empty if it was not

    @property
    def state(self) -> ArmState: ...  # noqa: D102
    async def line(  # noqa: D102
        self, poses: Sequence[Pose], speed: float, acceleration: float, seconds: float
    ) -> None: ...
    async def turn(self, spin: float, seconds: float, acceleration: float) -> None: ...  # noqa: D102
    async def wait(self, seconds: float) -> None: ...  # noqa: D102
    async def stop(self) -> None: ...  # noqa: D102
    def fail(self, reason: str) -> None: ...  # noqa: D102
    async def __aenter__(self) -> Self: ...
    async def __aexit__(self, *_: object) -> None: ...


class StrokeDriver(Source[Episodes]):
    """Driver of an arm along a planned path; source of the episodes, each at its end.

    Args:
        arm: The arm.
        clock: Clock of the run.
        require_contact: Stop the arm when a fingertip measures no contact in a stroke.

    Attributes:
        about: Description of the session.
        strokes: Number of completed strokes.
    """

    stale_after = None  # episodes are rare

    def __init__(self, arm: Arm, clock: Clock, *, require_contact: bool = True) -> None:
        self.about: Mapping[str, Json] = {}
        self.strokes = 0
        self._episodes = asyncio.Queue[Episodes]()
        self._arm, self._clock, self._require_contact = arm, clock, require_contact

    @property
    def kind(self) -> type[Episodes]:
        """Episodes."""
        return Episodes

    async def batches(self, clock: Clock) -> AsyncIterator[Episodes]:
        """Yield each episode when it has ended, until cancelled."""
        while True:
            yield await self._episodes.get()

    def describe(self) -> Description:
        """Return the description of the session."""
        return self.about

    async def make_strokes(self, series: StrokeSeries, monitor: ContactMonitor) -> None:
        """Stay in the air for the baseline, then make each stroke.

        Args:
            series: The strokes.
            monitor: Monitor of the fingertips.

        Raises:
            EndpointError: if the arm had to be stopped.
        """
        monitor.restart()
        await self._follow_as_episode(series, None, [series.baseline])
        monitor.set_baseline()
        for stroke in series.strokes:
            await self._make(series, stroke, monitor)
            self.strokes += 1

    async def follow(self, steps: Sequence[Step]) -> None:
        """Move along a path from the arm's pose.

        Raises:
            EndpointError: if the arm had to be stopped.
        """
        for step in steps:
            match step:
                case Line(poses, speed, acceleration):
                    seconds = step.seconds(self._arm.state.pose)
                    await self._arm.line(poses, speed, acceleration, seconds)
                case Turn(spin, time, acceleration):
                    await self._arm.turn(spin, time, acceleration)
                case Wait(time):
                    await self._arm.wait(time)

    async def _make(self, series: StrokeSeries, stroke: Stroke, monitor: ContactMonitor) -> None:
        await self.follow(stroke.approach)
        monitor.restart()
        await self._follow_as_episode(series, stroke, stroke.contact)
        without_contact = monitor.without_contact()
        await self.follow(stroke.retreat)
        if without_contact and self._require_contact:
            self._arm.fail(
                f"fingertip {without_contact[0]} measured no contact in a stroke: at the start, or at the"
                " planned pose, it must just touch the surface (limits.require_contact = false ignores this)"
            )
            await self._arm.wait(_POLL)  # raises

    async def _follow_as_episode(
        self, series: StrokeSeries, stroke: Stroke | None, steps: Sequence[Step]
    ) -> None:
        """Follow steps as an episode; `stroke` None: the baseline."""
        start = self._clock.now()
        try:
            await self.follow(steps)
        finally:
            end = max(self._clock.now(), start + 1)
            self._episodes.put_nowait(_episode(series, stroke, start, end))


def _episode(series: StrokeSeries, stroke: Stroke | None, start: int, end: int) -> Episodes:
    """Return an episode from `start` to `end` (ns) as a row; `stroke` None: the baseline."""
    motion, speed, rotates = "hold", 0.0, False
    if stroke:
        motion, speed, rotates = "rotation" if stroke.rotates else "translation", stroke.speed, stroke.rotates
    values = (
        stroke.direction if stroke else 0.0,
        0.0 if rotates else speed,
        speed if rotates else 0.0,
        series.plan.path.depth if stroke else math.nan,
        math.nan,  # the force is not measured
    )
    return Episodes(
        np.array([start]),
        np.array([end]),
        np.array([MOTIONS.index(motion)], np.int8),
        np.array([SURFACES.index(series.surface.shape)], np.int8),
        *(np.array([value]) for value in values),
    )
