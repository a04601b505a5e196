"""Collecting a plan: each session is recorded through a flow while the arm carries it out."""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Final

from connectors.ur.ur_arm import UrArm
from flows.graph import Flow
from flows.lab.collection.arm_path import Pose
from flows.lab.collection.contact_monitor import Felt
from flows.lab.collection.stroke_driver import Driver
from flows.lab.collection.stroke_plan import Session
from flows.run.live_runner import LiveRunner
from operators import Align, DeviceClock, Label, MaskLifted, Motion, Source, Touch, WatchClock, Zero, ms, s
from operators.errors import EndpointError, SlipflowError
from operators.ports import Clock, Json, Run
from storage import Dataset

APPEAR: Final = 10.0  # s, for a sensor to give its first reading
PATIENCE: Final = 0.3  # s without a valid reading after which a sensor is lost
_LOOK: Final = 0.05  # s, from look to look


def declare(
    touch: Source[Touch],
    motion: Source[Motion],
    place: Pose,
    *,
    dataset: Dataset,
    felt: Felt,
    delay: int = 0,
) -> Flow:
    """The flow of a session: both streams as received, labelled samples and the arm's clock are recorded.

    Args:
        touch: The fingertips.
        motion: The arm, stamped with its arrival and its controller's clock.
        place: Pose at which the fingertip just touches the surface.
        dataset: Where they go.
        felt: Is told of the touch, too.
        delay: How much later than the fingertips the arm tells of the same instant, ns; see `Label`.
    """
    flow = Flow("collect")
    felt_stream, moved = flow.source(touch, "touch"), flow.source(motion, "motion")
    samples = (felt_stream | Zero()) & (moved | DeviceClock()) | Align(within=20 * ms)
    labelled = (
        samples | Label(speed=0.003, rotation=0.2, delay=delay) | MaskLifted(place)
    )  # m/s, rad/s; paper
    felt_stream.to(dataset)
    moved.to(dataset)
    (moved | WatchClock()).to(dataset)
    labelled.to(dataset)
    felt_stream.to(felt)
    return flow


@dataclass
class Collection:
    """What it takes to collect, and what was collected.

    Attributes:
        arm: Opened, within its bounds.
        touch: The fingertips.
        motion: What the arm's controller tells.
        dataset: Made anew for each session.
        clock: Of all sessions.
        about: What every session says of the plan.
        delay: See `declare`, ns.
        patience: Without a valid reading of a fingertip, after which the arm is stopped, s.
        blind: Go on though a fingertip feels nothing of a stroke.
        told: Told what is being done.
        driver: Can be paused.
        runs: One for each session so far.
        interrupted: It was told to end.
    """

    arm: UrArm
    touch: Source[Touch]
    motion: Source[Motion]
    dataset: Callable[[], Dataset]
    clock: Clock
    about: dict[str, Json]
    delay: int = 0
    patience: float = PATIENCE
    blind: bool = False
    told: Callable[[str], None] = lambda _: None
    driver: Driver = field(init=False)
    runs: list[Run] = field(default_factory=list[Run], init=False)
    interrupted: bool = field(default=False, init=False)
    _runner: LiveRunner | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.driver = Driver(self.arm, self.clock, blind=self.blind)

    async def collect(self, sessions: Sequence[Session]) -> None:
        """Record all sessions; what a session had until the arm had to be stopped is committed.

        Raises:
            EndpointError: if the arm had to be stopped.
            SlipflowError: if a session cannot be recorded.
        """
        stamp = f"{datetime.fromtimestamp(self.clock.now() // s, UTC):%Y%m%dT%H%M%S}Z"
        for number, session in enumerate(sessions, 1):
            self.told(f"{number}/{len(sessions)} {session.name}: {len(session.strokes)} strokes")
            await self.driver.follow([session.begin])
            await self._record(session, f"{session.name}-{stamp}")

    def pause_or_resume(self) -> None:
        """Pause if it moves, go on if it is paused."""
        if self.driver.paused:
            self.told("going on")
            self.driver.resume()
        else:
            self.told("pausing: the arm stands until it is told to go on")
            self.driver.pause()

    def interrupt(self) -> None:
        """Stop the arm, and so the collection; again: give up what is still being written, as a run does."""
        if self.interrupted and self._runner:
            self._runner.stop()
        self.interrupted = True
        self.arm.fail("interrupted")

    async def _record(self, session: Session, name: str) -> None:
        felt, episodes = Felt(), list[Json]()
        place, dataset = session.surface.place, self.dataset()
        flow = declare(self.touch, self.motion, place, dataset=dataset, felt=felt, delay=self.delay)
        # a signal is the collection's, which stops the arm first
        runner = self._runner = LiveRunner(flow, name, clock=self.clock, signals=False)
        about: dict[str, Json] = {**self.about, **_described(session), "episodes": episodes}
        runner.run.describe["collection"] = about
        self.runs.append(runner.run)
        running = asyncio.create_task(runner.execute())
        driving = asyncio.create_task(self._drive(session, felt, episodes))
        try:
            await asyncio.wait({running, driving}, return_when=asyncio.FIRST_COMPLETED)
            if not driving.done():  # nothing is recorded any more
                self.arm.fail("the recording ended")
            await asyncio.wait({driving})
            if error := driving.exception():
                runner.run.error = error.reason if isinstance(error, EndpointError) else str(error)
        finally:
            driving.cancel()
            about["pressed"] = [_pressed(each) for each in episodes[1:]]
            runner.stop()
            recorded = await asyncio.gather(running, return_exceptions=True)
            self._runner = None
        if isinstance(recorded[0], SlipflowError):
            raise recorded[0]
        await driving

    async def _drive(self, session: Session, felt: Felt, episodes: list[Json]) -> None:
        watching = asyncio.create_task(self._watch(felt))
        try:
            await self._appear(felt)
            await self.driver.carry_out(session, episodes, felt)
        finally:
            watching.cancel()
            await asyncio.gather(watching, return_exceptions=True)

    async def _appear(self, felt: Felt) -> None:
        """Wait until every fingertip is there.

        Raises:
            EndpointError: if one is not.
        """
        end = self.clock.now() + round(APPEAR * s)
        while missing := set(self.touch.fingers) - set(felt.newest):
            if self.clock.now() > end:
                raise EndpointError("touch", f"fingertip {min(missing)} gives no reading")
            await self.arm.wait(_LOOK)

    async def _watch(self, felt: Felt) -> None:
        """Stop the arm when a fingertip is not felt any more."""
        while True:
            now = self.clock.now()
            for finger, newest in felt.newest.items():
                if now - newest > self.patience * s:
                    why = f"fingertip {finger} has given no reading for {self.patience:g} s (--patience)"
                    self.arm.fail(why)
            await self.clock.sleep_until(now + round(_LOOK * s))


def _pressed(episode: Json) -> Json:
    """How deep (m beyond the first touch), and with what force (N) if one was sought, a stroke began."""
    assert isinstance(episode, dict)
    return {key: episode[key] for key in ("start", "depth", "force")}


def _described(session: Session) -> dict[str, Json]:
    return {
        "recording": session.name,
        "surface": session.surface.curvature,
        "radius": None if session.surface.curvature == "plane" else session.surface.radius,
        "place": list(session.surface.place),
        "speed": session.speed,
        "depth": session.depth,
        "force": session.force,
        "strokes": len(session.strokes),
        "split": session.split,
    }
