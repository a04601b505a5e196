"""Driver of an arm through the strokes of a series; it is the source of their episodes."""

import asyncio
import math
from collections.abc import AsyncIterator, Mapping, Sequence
from typing import Final, Protocol, Self

import numpy as np

from connectors.ur.ur_state import ArmState, Point, Pose
from flows.lab.collection.arm_path import Line, Slide, Step, Trace, Wait, raise_pose
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
    async def line(self, pose: Pose, speed: float, acceleration: float, seconds: float) -> None: ...  # noqa: D102
    async def slide(self, velocity: Pose, seconds: float, acceleration: float) -> None: ...  # noqa: D102
    async def trace(  # noqa: D102
        self, points: Sequence[Point], speed: float, acceleration: float, seconds: float
    ) -> None: ...
    async def wait(self, seconds: float) -> None: ...  # noqa: D102
    async def stop(self) -> None: ...  # noqa: D102
    def fail(self, reason: str) -> None: ...  # noqa: D102
    async def __aenter__(self) -> Self: ...
    async def __aexit__(self, *_: object) -> None: ...


class StrokeDriver(Source[Episodes]):
    """Driver of an arm along a planned path, which can be paused; source of the episodes, each at its end.

    A pause stops the arm where it is. On resuming it moves straight up and repeats the interrupted stroke;
    the interrupted part stays in the recording, as a shorter episode.

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
        self._pause = asyncio.Event()

    @property
    def kind(self) -> type[Episodes]:
        """Episodes."""
        return Episodes

    async def batches(self, clock: Clock) -> AsyncIterator[Episodes]:  # noqa: ARG002 - Source's signature
        """Yield each episode when it has ended, until cancelled."""
        while True:
            yield await self._episodes.get()

    def describe(self) -> Description:
        """Return the description of the session."""
        return self.about

    @property
    def paused(self) -> bool:
        """True while the driver is paused."""
        return self._pause.is_set()

    def pause(self) -> None:
        """Stop until `resume`."""
        self._pause.set()

    def resume(self) -> None:
        """Continue."""
        self._pause.clear()

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
            await self._wait_until_resumed()
            while not await self._make_unless_paused(series, stroke, monitor):
                await self._wait_until_resumed()
                up = raise_pose(self._arm.state.pose, series.surface.middle, series.plan.path.clearance)
                await self.follow([Line(up, series.begin.speed, series.begin.acceleration)])
            self.strokes += 1

    async def follow(self, steps: Sequence[Step]) -> None:
        """Move along a path from the arm's pose.

        Raises:
            EndpointError: if the arm had to be stopped.
        """
        for step in steps:
            seconds = step.seconds(self._arm.state.pose)
            match step:
                case Line(pose, speed, acceleration):
                    await self._arm.line(pose, speed, acceleration, seconds)
                case Slide(velocity, time, acceleration):
                    await self._arm.slide(velocity, time, acceleration)
                case Trace(points, speed, acceleration):
                    await self._arm.trace(points, speed, acceleration, seconds)
                case Wait(time):
                    await self._arm.wait(time)

    async def _wait_until_resumed(self) -> None:
        """Wait while paused; raise if the arm has to be stopped meanwhile."""
        while self.paused:
            await self._arm.wait(_POLL)

    async def _make_unless_paused(
        self, series: StrokeSeries, stroke: Stroke, monitor: ContactMonitor
    ) -> bool:
        """Make a stroke; return False if it was interrupted by a pause, with the arm at rest."""
        work = asyncio.create_task(self._make(series, stroke, monitor))
        pause = asyncio.create_task(self._pause.wait())
        try:
            await asyncio.wait({work, pause}, return_when=asyncio.FIRST_COMPLETED)
            if work.done():
                await work
                return True
        finally:
            pause.cancel()
            if not work.done():
                work.cancel()
                await asyncio.gather(work, return_exceptions=True)
                await self._arm.stop()
        return False

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
        series.plan.press.depth if stroke else math.nan,
        math.nan,  # the force is not measured
    )
    return Episodes(
        np.array([start]),
        np.array([end]),
        np.array([MOTIONS.index(motion)], np.int8),
        np.array([SURFACES.index(series.surface.shape)], np.int8),
        *(np.array([value]) for value in values),
    )
