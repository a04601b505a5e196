"""Carrying out a session's strokes with an arm, and writing down when each was made."""

import asyncio
import math
from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol

from connectors.ur.ur_state import ArmState
from flows.lab.collection.arm_path import (
    Line,
    Place,
    Pose,
    Slide,
    Step,
    Tare,
    Touchdown,
    Trace,
    Wait,
    raised,
    shifted,
)
from flows.lab.collection.contact_monitor import Felt
from flows.lab.collection.stroke_plan import Session, Stroke
from operators.batch import s
from operators.ports import Clock, Json

_LOOK: Final = 0.05  # s, from look to look whether to go on


class Arm(Protocol):
    """What moves: a `connectors.ur.ur_arm.UrArm`. Its moves raise EndpointError once it had to be stopped."""

    state: ArmState

    async def line(self, pose: Pose, speed: float, acceleration: float, seconds: float) -> None:
        """Go straight to a pose, which is planned to take so many seconds."""
        ...

    async def slide(self, velocity: Pose, seconds: float, acceleration: float) -> None:
        """Go on with a velocity for a time, then come to rest."""
        ...

    async def trace(self, places: Sequence[Place], speed: float, acceleration: float, seconds: float) -> None:
        """Go along a line of places at one speed, which is planned to take so many seconds."""
        ...

    async def tare(self, seconds: float) -> None:
        """Take the force that is told while it stands in the air for none."""
        ...

    async def touch(self, way: Place, force: float, speed: float, acceleration: float) -> float:
        """Go straight on until a force is felt, by a way at most; the force (N) where it stands."""
        ...

    async def wait(self, seconds: float) -> None:
        """Go on as it is."""
        ...

    async def stop(self) -> None:
        """Come to rest."""
        ...

    def fail(self, why: str) -> None:
        """Stop for good; its moves raise from now on."""
        ...


class Found(NamedTuple):
    """What a touchdown found."""

    spared: Place = (0.0, 0.0, 0.0)  # m, by which it ended before the latest end that was planned
    force: float | None = None  # N


class Driver:
    """Moves an arm along the path of a plan, and can be paused.

    Who pauses stops the arm where it is. When it is resumed it goes straight up, and the stroke that was
    interrupted is made again; what there is of it stays in the recording, as an episode that is shorter.

    Args:
        arm: The arm.
        clock: Of the run.
        blind: Go on though a fingertip feels nothing of a stroke.

    Attributes:
        strokes: That have been made.
    """

    def __init__(self, arm: Arm, clock: Clock, *, blind: bool = False) -> None:
        self.strokes = 0
        self._arm, self._clock, self._blind = arm, clock, blind
        self._pause = asyncio.Event()

    @property
    def paused(self) -> bool:
        """Whether it is to stand still."""
        return self._pause.is_set()

    def pause(self) -> None:
        """Stand still until `resume`."""
        self._pause.set()

    def resume(self) -> None:
        """Go on."""
        self._pause.clear()

    async def carry_out(self, session: Session, episodes: list[Json], felt: Felt) -> None:
        """Stay in the air for a baseline, then make each stroke; episodes are added as they begin.

        Args:
            session: Its strokes.
            episodes: What was done when.
            felt: What the fingertips feel meanwhile.

        Raises:
            EndpointError: if the arm had to be stopped, or a stroke was not felt.
        """
        felt.begin()
        await self._noted(session, None, [session.air], episodes)
        felt.air()
        for stroke in session.strokes:
            await self._resumed()
            while not await self._unless_paused(session, stroke, episodes, felt):
                await self._resumed()
                up = raised(_pose(self._arm.state), session.surface.place, session.clearance)
                await self.follow([Line(up, session.begin.speed, session.begin.acceleration)])
            self.strokes += 1

    async def follow(self, steps: Sequence[Step]) -> Found:
        """Go along a path from where the arm is.

        Returns:
            What its touchdown found.

        Raises:
            EndpointError: if the arm had to be stopped.
        """
        found = Found()
        for step in steps:
            start = _pose(self._arm.state)
            seconds = step.seconds(start)
            match step:
                case Line(pose, speed, acceleration):
                    await self._arm.line(pose, speed, acceleration, seconds)
                case Slide(velocity, time, acceleration):
                    await self._arm.slide(velocity, time, acceleration)
                case Trace(places, speed, acceleration):
                    await self._arm.trace(places, speed, acceleration, seconds)
                case Wait(time):
                    await self._arm.wait(time)
                case Tare(time):
                    await self._arm.tare(time)
                case Touchdown(way, force, speed, acceleration):
                    felt = await self._arm.touch(way, force, speed, acceleration)
                    found = Found(step.spared(start, _pose(self._arm.state)), felt)
        return found

    async def _resumed(self) -> None:
        """Wait until it may go on; the arm may have to be stopped meanwhile, too."""
        while self.paused:
            await self._arm.wait(_LOOK)

    async def _unless_paused(
        self, session: Session, stroke: Stroke, episodes: list[Json], felt: Felt
    ) -> bool:
        """Make a stroke; False: it was paused, and the arm stands."""
        work = asyncio.create_task(self._make(session, stroke, episodes, felt))
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

    async def _make(self, session: Session, stroke: Stroke, episodes: list[Json], felt: Felt) -> None:
        found = await self.follow(stroke.approach)
        felt.begin()
        await self._noted(session, stroke, shifted(stroke.contact, found.spared), episodes, found)
        untouched = felt.untouched()
        await self.follow(stroke.retreat)
        if untouched and not self._blind:
            self._arm.fail(
                f"fingertip {untouched[0]} felt nothing of a stroke: it has to just touch the surface"
                " at the place that was given, or else at the beginning; --unfelt goes on all the same"
            )
            await self._arm.wait(_LOOK)  # raises

    async def _noted(
        self,
        session: Session,
        stroke: Stroke | None,
        steps: Sequence[Step],
        episodes: list[Json],
        found: Found = Found(),  # noqa: B008 - it never changes
    ) -> None:
        """Follow steps as an episode; None is staying in the air."""
        start, place = self._clock.now(), session.surface.place
        longest = sum(2 * step.seconds(place) + 2 for step in steps)  # s; what the arm is given
        episode: dict[str, Json] = {
            "start": start,
            "end": start + round(longest * s),
            "motion": stroke.motion if stroke else "hold",
            "axis": stroke.axis if stroke else "primary",
            "direction_deg": stroke.direction_deg if stroke else 0.0,
            "speed": stroke.speed if stroke else 0.0,
            "curvature": session.surface.curvature,
            "split": session.split,
            "depth": stroke.depth - math.hypot(*found.spared) if stroke else None,  # m beyond the first touch
            "force": found.force,  # N at its beginning, where it was sought
        }
        episodes.append(episode)
        try:
            await self.follow(steps)
        finally:
            episode["end"] = max(self._clock.now(), start + 1)


def _pose(state: ArmState) -> Pose:
    x, y, z, a, b, c = state.pose
    return x, y, z, a, b, c
