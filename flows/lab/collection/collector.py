"""Execution of a collection plan: a flow records each series of strokes while the arm makes them."""

import asyncio
import signal
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import aclosing
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, cast

from connectors import TakkTile, UrMotion
from connectors.takktile.i2c_access import I2cBus
from connectors.ur.control_process import Pose
from connectors.ur.path_follower import Point
from connectors.ur.ur_arm import UrArm
from connectors.ur.ur_state import Bounds, read_state
from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow
from flows.lab.collection.contact_monitor import ContactMonitor
from flows.lab.collection.stroke_driver import StrokeDriver
from flows.lab.collection.stroke_plan import CollectionPlan, Limits, StrokeSeries, total_extent
from flows.run.clocks import LoopClock
from flows.run.live_runner import LiveRunner
from flows.run.stop_signals import signal_handlers
from operators import (
    Align,
    DeviceClock,
    Label,
    MaskLifted,
    Motion,
    Source,
    Touch,
    WatchClock,
    Zero,
    ms,
    s,
)
from operators.errors import EndpointError, ParameterError
from operators.ports import Clock, Json, Run
from storage import Dataset, arrow
from storage.background_task import BackgroundTask

FIRST_SAMPLE: Final = 10.0  # s; longest wait for the first sample of a fingertip
_POLL: Final = 0.05  # s


async def collect(
    plan: CollectionPlan,
    robot: str,
    out: Path,
    *,
    bus: int | str | I2cBus = 1,
    rows: tuple[int, ...] = (0,),
    seed: int = 0,
    log: Callable[[str], None] = lambda _: None,
    clock: Clock | None = None,
) -> "Collector":
    """Execute a plan and record it; SIGUSR1 pauses and resumes, SIGINT and SIGTERM stop the arm first.

    Args:
        plan: Plan of the strokes.
        robot: Address of the UR controller.
        out: Folder of the dataset.
        bus: I2C bus of the fingertips, see `TakkTile`.
        rows: Rows of the fingertips on the bus.
        seed: Random seed of the order of directions.
        log: Called with progress messages.
        clock: Clock of all sessions; default: `LoopClock`.

    Raises:
        EndpointError: if a device is not ready; nothing has moved then.
        ParameterError: if the path leaves the workspace.
        SlipflowError: if a session cannot be recorded; the arm stands still.
    """
    clock = clock or LoopClock()
    here = await read_pose(robot, clock)
    series = plan.series(here, seed)
    low, high = workspace(series, here, plan.limits)
    touch = TakkTile(bus, rows)
    await _check_sampling(touch, clock)
    await asyncio.to_thread(arrow.load)
    limits = plan.limits
    bounds = Bounds(low, high, limits.force)
    arm = UrArm(robot, bounds, clock, watchdog=limits.watchdog, path_tolerance=limits.margin)
    collector = Collector(
        arm,
        touch,
        UrMotion(robot),
        out,
        clock,
        plan,
        {"plan": plan.name, "seed": seed, "workspace": [*low, *high], "force_limit": limits.force},
        log,
    )
    await asyncio.to_thread(collector.compile_operators, here)
    stop = collector.interrupt
    actions = {signal.SIGINT: stop, signal.SIGTERM: stop, signal.SIGUSR1: collector.pause_or_resume}
    with signal_handlers(actions):
        try:
            async with arm:
                await collector.collect(series)
        except EndpointError as stopped:
            if not arm.fault or not (collector.runs or collector.interrupted):
                raise
            collector.error = str(stopped)
    return collector


async def _check_sampling(touch: TakkTile, clock: Clock) -> None:
    """Wait for a first sample.

    Raises:
        EndpointError: if none arrives.
    """
    batches = cast("AsyncGenerator[Touch]", touch.batches(clock))
    try:
        async with asyncio.timeout(FIRST_SAMPLE), aclosing(batches):
            await anext(batches)
    except TimeoutError as error:
        raise EndpointError(touch.path, f"gives no sample within {FIRST_SAMPLE:g} s") from error


async def read_pose(robot: str, clock: Clock) -> Pose:
    """Return the TCP pose of an arm.

    Raises:
        EndpointError: if its controller sends no state.
    """
    x, y, z, a, b, c = (await read_state(clock, robot)).pose
    return x, y, z, a, b, c


def workspace(series: Sequence[StrokeSeries], here: Pose | None, limits: Limits) -> tuple[Point, Point]:
    """Return the lowest and highest corner (m) of the workspace: as planned, or the path with its margin.

    Raises:
        ParameterError: if the path, from the arm's pose if known, leaves the planned workspace.
    """
    path, margin = total_extent(series, here), limits.margin
    if limits.workspace is None:
        a, b, c = (each - margin for each in path.low)
        d, e, f = (each + margin for each in path.high)
        return (a, b, c), (d, e, f)
    low, high = limits.workspace[:3], limits.workspace[3:]
    for axis, a, b, c, d in zip("xyz", low, path.low, path.high, high, strict=True):
        if not a <= b <= c <= d:
            must_be = f"around the path, which leads from {b:.4f} to {c:.4f} m along {axis}"
            raise ParameterError("collect", "limits.workspace", [*low, *high], must_be)
    return low, high


@dataclass
class Collector:
    """Recorder of series of strokes, one session each.

    Attributes:
        arm: Open arm.
        touch: Source of the fingertips.
        motion: Source of the arm's motion.
        out: Folder of the dataset.
        clock: Clock of all sessions.
        plan: The plan, for its limits and label delay.
        about: Description of the collection, copied to every session.
        log: Called with progress messages.
        driver: Driver of the arm.
        runs: One run for each series so far.
        error: Reason why the arm was stopped; empty: it was not.
        interrupted: True after `interrupt`.
    """

    arm: UrArm
    touch: Source[Touch]
    motion: Source[Motion]
    out: Path
    clock: Clock
    plan: CollectionPlan
    about: dict[str, Json]
    log: Callable[[str], None] = lambda _: None
    driver: StrokeDriver = field(init=False)
    runs: list[Run] = field(default_factory=list[Run], init=False)
    error: str = field(default="", init=False)
    interrupted: bool = field(default=False, init=False)
    _runner: LiveRunner | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.driver = StrokeDriver(self.arm, self.clock, require_contact=self.plan.limits.require_contact)

    async def collect(self, series: Sequence[StrokeSeries]) -> None:
        """Record all series; if the arm has to be stopped, the part recorded so far is committed.

        Raises:
            EndpointError: if the arm had to be stopped.
            SlipflowError: if a session cannot be recorded.
        """
        stamp = f"{datetime.fromtimestamp(self.clock.now() // s, UTC):%Y%m%dT%H%M%S}Z"
        for number, each in enumerate(series, 1):
            self.log(f"{number}/{len(series)} {each.name}: {len(each.strokes)} strokes")
            await self.driver.follow([each.begin])
            await self._record(each, f"{each.name}-{stamp}")

    def compile_operators(self, surface: Pose) -> None:
        """Compile the operators of a session; once the arm is commanded, this would delay the commands."""
        CompiledFlow(self._declare(surface, ContactMonitor()))

    def pause_or_resume(self) -> None:
        """Pause, or resume if paused."""
        if self.driver.paused:
            self.log("resuming")
            self.driver.resume()
        else:
            self.log("paused: the arm stands still until the next SIGUSR1")
            self.driver.pause()

    def interrupt(self) -> None:
        """Stop the arm and end the collection; a second call also stops the writing of the session."""
        if self.interrupted and self._runner:
            self._runner.stop()
        self.interrupted = True
        self.arm.fail("interrupted")

    async def _record(self, series: StrokeSeries, name: str) -> None:
        monitor = ContactMonitor()
        self.driver.about = {**self.about, "recording": series.name, **series.describe()}
        flow = self._declare(series.surface.middle, monitor)
        # signals are handled by the collection, which stops the arm first
        runner = self._runner = LiveRunner(flow, name, clock=self.clock, signals=False)
        self.runs.append(runner.run)
        running = asyncio.create_task(runner.execute())
        driving = asyncio.create_task(self._drive(series, monitor))
        try:
            await asyncio.wait({running, driving}, return_when=asyncio.FIRST_COMPLETED)
            if not driving.done():  # recording has ended
                self.arm.fail("the recording ended")
            await asyncio.wait({driving})
            if error := driving.exception():
                runner.run.error = error.reason if isinstance(error, EndpointError) else str(error)
        finally:
            driving.cancel()
            await asyncio.wait({driving})  # the last episode has been emitted
            runner.stop()
            recorded = await asyncio.gather(running, return_exceptions=True)
            self._runner = None
        if isinstance(recorded[0], Exception):
            raise recorded[0]
        await driving

    def _declare(self, surface: Pose, monitor: ContactMonitor) -> Flow:
        """Return the flow of a session, which records both raw streams, labelled samples and the arm's clock.

        At the pose `surface` the fingertip just touches the surface.
        """
        flow, dataset = Flow("collect"), Dataset(self.out)
        touch, motion = flow.source(self.touch, "touch"), flow.source(self.motion, "motion")
        samples = (touch | Zero()) & (motion | DeviceClock()) | Align(within=20 * ms)
        label = Label(speed=0.003, rotation=0.2, delay=self.plan.label_delay)  # m/s, rad/s; paper
        touch.to(dataset)
        motion.to(dataset)
        (motion | WatchClock()).to(dataset)
        (samples | label | MaskLifted(surface)).to(dataset)
        flow.source(self.driver, "collection").to(dataset)
        touch.to(monitor)
        return flow

    async def _drive(self, series: StrokeSeries, monitor: ContactMonitor) -> None:
        watching = BackgroundTask("touch", "the watch for samples", self._watch(monitor), self.arm.fail)
        try:
            await self._wait_for_first_samples(monitor)
            await self.driver.make_strokes(series, monitor)
        finally:
            await watching.end()

    async def _wait_for_first_samples(self, monitor: ContactMonitor) -> None:
        """Wait until every fingertip has given a sample.

        Raises:
            EndpointError: if one does not.
        """
        end = self.clock.now() + round(FIRST_SAMPLE * s)
        while missing := set(self.touch.fingers) - set(monitor.newest):
            if self.clock.now() > end:
                raise EndpointError("touch", f"fingertip {min(missing)} gives no sample")
            await self.arm.wait(_POLL)

    async def _watch(self, monitor: ContactMonitor) -> None:
        """Stop the arm when a fingertip gives no more samples."""
        timeout = self.plan.limits.sensor_timeout
        while True:
            now = self.clock.now()
            for finger, newest in monitor.newest.items():
                if now - newest > timeout * s:
                    reason = (
                        f"fingertip {finger} has given no sample for {timeout:g} s (limits.sensor_timeout)"
                    )
                    self.arm.fail(reason)
            await self.clock.sleep_until(now + round(_POLL * s))
