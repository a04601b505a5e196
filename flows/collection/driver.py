"""Carrying out a session's strokes with an arm, and writing down when each was made."""

import asyncio
from collections.abc import Sequence
from typing import Protocol

from connectors.ur_state import State
from flows.collection.path import (
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
from flows.collection.plan import Session, Stroke
from operators.batch import s
from operators.ports import Clock, Json


class Arm(Protocol):
    """What moves: a `connectors.ur_arm.UrArm`. Its moves raise EndpointError once it had to be stopped."""

    state: State

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

    async def touch(self, way: Place, force: float, speed: float, acceleration: float) -> None:
        """Go straight on until a force is felt, by a way at most."""
        ...

    async def wait(self, seconds: float) -> None:
        """Go on as it is."""
        ...

    async def stop(self) -> None:
        """Come to rest."""
        ...


class Driver:
    """Moves an arm along the path of a plan, and can be paused.

    Who pauses stops the arm where it is. When it is resumed it goes straight up, and the stroke that was
    interrupted is made again; what there is of it stays in the recording, as an episode that is shorter.

    Args:
        arm: The arm.
        clock: Of the run.

    Attributes:
        strokes: That have been made.
    """

    def __init__(self, arm: Arm, clock: Clock) -> None:
        self.strokes = 0
        self._arm, self._clock = arm, clock
        self._pause, self._resume = asyncio.Event(), asyncio.Event()
        self._resume.set()

    @property
    def paused(self) -> bool:
        """Whether it is to stand still."""
        return self._pause.is_set()

    def pause(self) -> None:
        """Stand still until `resume`."""
        self._resume.clear()
        self._pause.set()

    def resume(self) -> None:
        """Go on."""
        self._pause.clear()
        self._resume.set()

    async def carry_out(self, session: Session, episodes: list[Json]) -> None:
        """Stay in the air for a baseline, then make each stroke; episodes are added as they begin.

        Raises:
            EndpointError: if the arm had to be stopped.
        """
        await self._noted(session, None, [session.air], episodes)
        for stroke in session.strokes:
            await self._resume.wait()
            while not await self._unless_paused(session, stroke, episodes):
                await self._resume.wait()
                up = raised(_pose(self._arm.state), session.surface.place, session.clearance)
                await self.follow([Line(up, session.begin.speed, session.begin.acceleration)])
            self.strokes += 1

    async def follow(self, steps: Sequence[Step]) -> Place:
        """Go along a path from where the arm is.

        Returns:
            How far (m) its touchdown ended before the latest end that was planned.

        Raises:
            EndpointError: if the arm had to be stopped.
        """
        spared = 0.0, 0.0, 0.0
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
                    await self._arm.touch(way, force, speed, acceleration)
                    spared = step.spared(start, _pose(self._arm.state))
        return spared

    async def _unless_paused(self, session: Session, stroke: Stroke, episodes: list[Json]) -> bool:
        """Make a stroke; False: it was paused, and the arm stands."""
        work = asyncio.create_task(self._make(session, stroke, episodes))
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

    async def _make(self, session: Session, stroke: Stroke, episodes: list[Json]) -> None:
        spared = await self.follow(stroke.approach)
        await self._noted(session, stroke, shifted(stroke.contact, spared), episodes)
        await self.follow(stroke.retreat)

    async def _noted(
        self, session: Session, stroke: Stroke | None, steps: Sequence[Step], episodes: list[Json]
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
        }
        episodes.append(episode)
        try:
            await self.follow(steps)
        finally:
            episode["end"] = max(self._clock.now(), start + 1)


def _pose(state: State) -> Pose:
    x, y, z, a, b, c = state.pose
    return x, y, z, a, b, c
