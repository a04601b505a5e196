"""Execution of a collection plan: a flow records each series of strokes while the arm makes them."""

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, cast

from connectors.sim.scene import Moves, Scene, Vibration
from connectors.sim.simulated_arm import SimulatedArm
from connectors.ur.ur_state import Pose
from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow
from flows.lab.collection.contact_monitor import ContactMonitor
from flows.lab.collection.stroke_driver import Arm, StrokeDriver
from flows.lab.collection.stroke_plan import PlannedPath, StrokeSeries
from flows.run.live_runner import LiveRunner
from flows.run.supervision import signals_to
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
from operators.errors import EndpointError, InputError
from operators.ports import Clock, Json, Run
from storage import Dataset, arrow
from storage.background_task import BackgroundTask

FIRST_SAMPLE: Final = 10.0  # s; longest wait for the first sample of a fingertip
_POLL: Final = 0.05  # s


async def collect(collector: "Collector") -> None:
    """Execute a plan and record it; SIGINT and SIGTERM stop the arm first.

    Args:
        collector: Recorder of the strokes; its `error` says why the arm was stopped.

    Raises:
        EndpointError: if a device is not ready; nothing has moved then.
        SlipflowError: if a session cannot be recorded; the arm stands still.
    """
    await _check_sampling(collector.touch, collector.clock)
    await asyncio.to_thread(arrow.load)
    await asyncio.to_thread(collector.compile_operators)
    with signals_to(collector.interrupt):
        try:
            async with collector.arm:
                await collector.collect()
        except EndpointError as stopped:
            if not collector.arm.fault or not (collector.runs or collector.interrupted):
                raise
            collector.error = str(stopped)


async def _check_sampling(touch: Source[Touch], clock: Clock) -> None:
    """Wait for a first sample.

    Raises:
        EndpointError: if none arrives.
    """
    batches = cast("AsyncGenerator[Touch]", touch.batches(clock))
    try:
        async with asyncio.timeout(FIRST_SAMPLE), aclosing(batches):
            await anext(batches)
    except TimeoutError as error:
        raise EndpointError("touch", f"gives no sample within {FIRST_SAMPLE:g} s") from error


@dataclass
class Collector:
    """Recorder of series of strokes, one session each."""

    path: PlannedPath
    arm: Arm  # makes the strokes; `collect` opens and closes it
    touch: Source[Touch]
    motion: Source[Motion]
    out: Path  # folder of the dataset
    clock: Clock  # of all sessions
    log: Callable[[str], None] = lambda _: None
    driver: StrokeDriver = field(init=False)
    runs: list[Run] = field(default_factory=list[Run], init=False)  # one for each series so far
    error: str = field(default="", init=False)  # why the arm was stopped; empty: it was not
    interrupted: bool = field(default=False, init=False)  # True after `interrupt`
    _runner: LiveRunner | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.driver = StrokeDriver(
            self.arm, self.clock, require_contact=self.path.plan.limits.require_contact
        )

    async def collect(self) -> None:
        """Record all series; if the arm has to be stopped, the part recorded so far is committed.

        Raises:
            EndpointError: if the arm had to be stopped.
            SlipflowError: if a session cannot be recorded.
        """
        series = self.path.series
        stamp = f"{datetime.fromtimestamp(self.clock.now() // s, UTC):%Y%m%dT%H%M%S}Z"
        for number, each in enumerate(series, 1):
            self.log(f"{number}/{len(series)} {each.name}: {len(each.strokes)} strokes")
            await self.driver.follow([each.begin])
            await self._record(each, f"{each.name}-{stamp}")

    def compile_operators(self) -> None:
        """Compile the operators of a session; once the arm is commanded, this would delay the commands."""
        CompiledFlow(self._declare(self.path.series[0].surface.middle, ContactMonitor()))

    def interrupt(self) -> None:
        """Stop the arm and end the collection; a second call also stops the writing of the session."""
        if self.interrupted and self._runner:
            self._runner.stop()
        self.interrupted = True
        self.arm.fail("interrupted")

    async def _record(self, series: StrokeSeries, name: str) -> None:
        monitor, plan = ContactMonitor(), self.path.plan
        about: dict[str, Json] = {
            "plan": plan.name,
            "seed": plan.seed,
            "workspace": [*self.path.low, *self.path.high],
        }
        about |= {"force_limit": plan.limits.force, "recording": series.name}
        self.driver.about = {**about, **series.describe()}
        flow = self._declare(series.surface.middle, monitor)
        # signals are handled by the collection, which stops the arm first
        runner = self._runner = LiveRunner(flow, name, clock=self.clock)
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
        label = Label(speed=0.003, rotation=0.2, delay=self.path.plan.label_delay)  # m/s, rad/s; paper
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
        timeout = self.path.plan.limits.sensor_timeout
        while True:
            now = self.clock.now()
            for finger, newest in monitor.newest.items():
                if now - newest > timeout * s:
                    reason = (
                        f"fingertip {finger} has given no sample for {timeout:g} s (limits.sensor_timeout)"
                    )
                    self.arm.fail(reason)
            await self.clock.sleep_until(now + round(_POLL * s))


async def virtual_arm(path: PlannedPath, clock: Clock, fingers: tuple[int, ...] = (0,)) -> SimulatedArm:
    """Return a simulated arm over the surface of a plan; the first one in a process compiles the physics.

    Raises:
        InputError: if the plan has several surfaces.
    """
    from connectors.sim.finger import compile_physics

    surface, plan = path.series[0].surface, path.plan
    if len(plan.surfaces) > 1:
        raise InputError(plan.name, "has several surfaces; the virtual arm has one")
    await asyncio.to_thread(compile_physics)
    scene = Scene(Moves(()), surface.shape, surface.radius, vibration=Vibration())
    return SimulatedArm(scene, surface.middle, path.bounds, clock, seed=plan.seed, fingers=fingers)
