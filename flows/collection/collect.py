"""Collecting a plan: each session is recorded through a flow while the arm carries it out."""

import asyncio
import signal
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Final

from connectors.ur_arm import UrArm
from flows.collection.driver import Driver
from flows.collection.path import Pose
from flows.collection.plan import Session
from flows.graph import Flow
from flows.live_runner import LiveRunner
from operators import Align, DeviceClock, Label, Lifted, Motion, Source, Touch, WatchClock, Zero, ms, s
from operators.errors import EndpointError, SlipflowError
from operators.ports import Clock, Json, Run, Sink
from storage import Dataset

APPEAR: Final = 10.0  # s, for a sensor to give its first reading
PATIENCE: Final = 0.3  # s without a valid reading after which a sensor is lost
_LOOK: Final = 0.05  # s, from look to look
_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


class Felt(Sink[Touch]):
    """When each fingertip gave its newest valid reading."""

    lossless = False

    def __init__(self) -> None:
        self.newest = dict[int, int]()  # ns, by finger

    @property
    def place(self) -> str:
        """Nowhere."""
        return "what was felt"

    async def open(self, run: Run) -> None:
        """Begin anew."""
        del run
        self.newest.clear()

    async def write(self, batch: Touch) -> None:
        """Take note."""
        if batch.valid[-1].any():
            self.newest[batch.finger] = int(batch.time[-1])


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
    labelled = samples | Label(speed=0.003, rotation=0.2, delay=delay) | Lifted(place)  # m/s, rad/s; paper
    felt_stream.to(dataset)
    moved.to(dataset)
    (moved | WatchClock()).to(dataset)
    labelled.to(dataset)
    felt_stream.to(felt)
    return flow


class CollectionRunner(LiveRunner):
    """A live run that stops the arm first when it is told to stop, as by Ctrl-C."""

    def __init__(self, flow: Flow, session: str, clock: Clock, interrupt: Callable[[], None]) -> None:
        super().__init__(flow, session, clock=clock)
        self._interrupt = interrupt

    def stop(self) -> None:
        """Stop the arm, then end the run."""
        self._interrupt()
        super().stop()

    def finish(self) -> None:
        """End the run: the session is complete."""
        super().stop()


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
        told: Told what is being done.
        driver: Can be paused.
        runs: One for each session so far.
    """

    arm: UrArm
    touch: Source[Touch]
    motion: Source[Motion]
    dataset: Callable[[], Dataset]
    clock: Clock
    about: dict[str, Json]
    delay: int = 0
    patience: float = PATIENCE
    told: Callable[[str], None] = lambda _: None
    driver: Driver = field(init=False)
    runs: list[Run] = field(default_factory=list[Run], init=False)
    interrupted: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self.driver = Driver(self.arm, self.clock)

    async def collect(self, sessions: Sequence[Session]) -> None:
        """Record all sessions; what a session had until the arm had to be stopped is committed.

        Raises:
            EndpointError: if the arm had to be stopped.
            SlipflowError: if a session cannot be recorded.
        """
        loop = asyncio.get_running_loop()
        stamp = f"{datetime.fromtimestamp(self.clock.now() // s, UTC):%Y%m%dT%H%M%S}Z"
        for number, session in enumerate(sessions, 1):
            self.told(f"{number}/{len(sessions)} {session.name}: {len(session.strokes)} strokes")
            with suppress(RuntimeError, ValueError):  # not in the main thread; a run takes them over
                for each in _SIGNALS:
                    loop.add_signal_handler(each, self.interrupt)
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
        """Stop the arm, and so the collection."""
        self.interrupted = True
        self.arm.fail("interrupted")

    async def _record(self, session: Session, name: str) -> None:
        felt, episodes = Felt(), list[Json]()
        place, dataset = session.surface.place, self.dataset()
        flow = declare(self.touch, self.motion, place, dataset=dataset, felt=felt, delay=self.delay)
        runner = CollectionRunner(flow, name, self.clock, self.interrupt)
        runner.run.describe["collection"] = {**self.about, **_described(session), "episodes": episodes}
        self.runs.append(runner.run)
        running = asyncio.create_task(runner.execute())
        driving = asyncio.create_task(self._drive(session, felt, episodes))
        try:
            await asyncio.wait({running, driving}, return_when=asyncio.FIRST_COMPLETED)
            if not driving.done():  # nothing is recorded any more
                self.arm.fail("the recording ended")
            await asyncio.wait({driving})
            if error := driving.exception():
                runner.run.error = str(error)
        finally:
            driving.cancel()
            runner.finish()
            recorded = await asyncio.gather(running, return_exceptions=True)
        if isinstance(recorded[0], SlipflowError):
            raise recorded[0]
        await driving

    async def _drive(self, session: Session, felt: Felt, episodes: list[Json]) -> None:
        watching = asyncio.create_task(self._watch(felt))
        try:
            await self._appear(felt)
            await self.driver.carry_out(session, episodes)
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
                    self.arm.fail(f"fingertip {finger} has given no reading for {self.patience} s")
            await self.clock.sleep_until(now + round(_LOOK * s))


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
