"""Execution of a collection plan: a flow records each series of strokes while the arm makes them."""

import asyncio
import math
from collections import Counter
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Sequence
from contextlib import aclosing
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, TypeAlias, cast

import numpy as np

from connectors.sim.scene import Move, Scene, Vibration
from connectors.sim.simulated_arm import SimulatedArm
from connectors.sim.simulated_rig import episode
from connectors.ur.ur_arm import UrArm
from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow
from flows.lab.collection.arm_path import Line, Step, Turn
from flows.lab.collection.stroke_plan import PlannedPath, Stroke, StrokeSeries
from flows.learn.labelled_recordings import PAPER_LABEL
from flows.run.live_runner import LiveRunner
from flows.run.run_summary import Summary
from flows.run.supervision import signals_to
from operators import Align, DeviceClock, MaskLifted, Motion, Source, Touch, Zero, ms, s
from operators.batch import Episodes, MotionKind, Reals
from operators.errors import EndpointError, InputError
from operators.ports import Clock, Description, Run, Sink
from storage import Dataset, arrow
from storage.background_task import BackgroundTask

FIRST_SAMPLE: Final = 10.0  # s; longest wait for the first sample of a fingertip
LEAST_CHANGE: Final = 2.0  # counts (0.25 kPa); contact changes a cell's mean by at least this much
_POLL: Final = 0.05  # s
Arm: TypeAlias = UrArm | SimulatedArm  # with the same moves


class ContactMonitor(Sink[Touch]):
    """Sink that keeps the time of each fingertip's newest valid sample, and the means of its counts.

    Attributes:
        newest: Time of the newest valid sample, ns, by finger.
    """

    lossless = False

    def __init__(self) -> None:
        self.newest = dict[int, int]()
        self._sums = dict[int, Reals]()  # (2, 6) sums of counts and numbers of valid samples, by finger
        self._baseline = dict[int, Reals]()  # (6,) counts, by finger

    @property
    def destination(self) -> str:
        """Name among the sinks of a flow; nothing is written."""
        return "contact monitor"

    async def open(self, run: Run) -> None:
        """Do nothing: a monitor serves one session."""

    def take(self, batch: Touch) -> bool:
        """Store the time of the newest valid sample, and add the counts to the means."""
        if batch.valid[-1].any():
            self.newest[batch.finger] = int(batch.time[-1])
        more = np.stack([batch.counts * batch.valid, batch.valid]).sum(axis=1, dtype=np.float64)
        self._sums[batch.finger] = self._sums.get(batch.finger, np.zeros((2, 6))) + more
        return True

    def restart(self) -> None:
        """Reset the means."""
        self._sums.clear()

    def set_baseline(self) -> None:
        """Store the current means as the baseline without contact."""
        self._baseline = self._means()

    def without_contact(self) -> list[int]:
        """Return the fingertips whose means do not differ from the baseline; omit those without samples."""
        unknown = np.full(6, np.nan)
        change = {f: np.abs(mean - self._baseline.get(f, unknown)) for f, mean in self._means().items()}
        return sorted(
            finger
            for finger, cells in change.items()  # (6,)
            if not (np.isnan(cells).all() or (cells >= LEAST_CHANGE).any())
        )

    def _means(self) -> dict[int, Reals]:
        """Return the mean of each cell (6,), by finger; NaN without samples."""
        with np.errstate(invalid="ignore"):
            return {finger: total / number for finger, (total, number) in self._sums.items()}


class Collector(Source[Episodes]):
    """Recorder of series of strokes, one session each; it drives the arm and gives the episodes.

    Args:
        path: Path of the plan.
        arm: Arm that makes the strokes; `collect` opens and closes it.
        touch: Source of the fingertips.
        motion: Source of the arm's motion.
        out: Folder of the dataset.
        clock: Clock of all sessions.
        log: Called with the name of each series.

    Attributes:
        strokes: Number of completed strokes.
        summaries: Summary of the session of each series so far.
        error: Reason why the arm was stopped; empty if it was not.
        interrupted: True after `interrupt`.
    """

    stale_after = None  # episodes are rare

    def __init__(
        self,
        path: PlannedPath,
        arm: Arm,
        touch: Source[Touch],
        motion: Source[Motion],
        out: Path,
        clock: Clock,
        log: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.path, self.arm, self.touch, self.clock = path, arm, touch, clock
        self.strokes, self.summaries, self.error, self.interrupted = 0, list[Summary](), "", False
        self._motion, self._out, self._log = motion, out, log
        self._episodes = asyncio.Queue[Episodes]()
        self._series = path.series[0]  # current one
        self._runner: LiveRunner | None = None

    @property
    def kind(self) -> type[Episodes]:
        """Episodes."""
        return Episodes

    async def batches(self, clock: Clock) -> AsyncIterator[Episodes]:
        """Yield each episode when it has ended, until cancelled."""
        while True:
            yield await self._episodes.get()

    def describe(self) -> Description:
        """Return plan, limits and series of the session."""
        plan = self.path.plan
        return {
            "plan": plan.name,
            "seed": plan.seed,
            "workspace": [*self.path.bounds.low, *self.path.bounds.high],
            "force_limit": plan.limits.force,
            "recording": self._series.name,
            **self._series.describe(),
        }

    async def collect(self) -> None:
        """Execute the plan and record it; SIGINT and SIGTERM stop the arm first, the recorded part is kept.

        Raises:
            EndpointError: if a device is not ready; nothing has moved then.
            SlipflowError: if a session cannot be recorded; the arm stands still.
        """
        await self._check_sampling()
        await asyncio.to_thread(arrow.load)
        flow = self._declare(ContactMonitor())
        await asyncio.to_thread(CompiledFlow, flow)  # later this would delay the commands
        with signals_to(self.interrupt):
            try:
                async with self.arm:
                    await self._record_all()
            except EndpointError as stopped:
                if not self.arm.fault or not (self.summaries or self.interrupted):
                    raise
                self.error = str(stopped)

    def interrupt(self) -> None:
        """Stop the arm and end the collection; a second call also stops the writing of the session."""
        if self.interrupted and self._runner:
            self._runner.stop()
        self.interrupted = True
        self.arm.fail("interrupted")

    async def _check_sampling(self) -> None:
        """Wait for a first valid sample of every fingertip.

        Raises:
            EndpointError: if one gives none.
        """
        batches = cast("AsyncGenerator[Touch]", self.touch.batches(self.clock))
        missing = set(self.touch.fingers)
        try:
            async with asyncio.timeout(FIRST_SAMPLE), aclosing(batches):
                while missing:
                    touch = await anext(batches)
                    missing -= {touch.finger} if touch.valid.any() else set()
        except TimeoutError as error:
            reason = f"fingertip {min(missing)} gives no sample within {FIRST_SAMPLE:g} s"
            raise EndpointError("touch", reason) from error

    async def _record_all(self) -> None:
        series = self.path.series
        stamp = f"{datetime.fromtimestamp(self.clock.now() // s, UTC):%Y%m%dT%H%M%S}Z"
        for number, self._series in enumerate(series, 1):
            self._log(f"{number}/{len(series)} {self._series.name}: {len(self._series.strokes)} strokes")
            await self._follow([self._series.begin])
            await self._record(f"{self._series.name}-{stamp}")

    async def _record(self, name: str) -> None:
        monitor = ContactMonitor()
        # signals are handled by the collection, which stops the arm first
        runner = self._runner = LiveRunner(self._declare(monitor), name, clock=self.clock)
        running = asyncio.create_task(runner.execute())
        driving = asyncio.create_task(self._drive(monitor))
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
            self.summaries.append(Summary.of(runner.run))
        if isinstance(recorded[0], Exception):
            raise recorded[0]
        await driving

    def _declare(self, monitor: ContactMonitor) -> Flow:
        """Return the flow of a session: raw streams, labelled samples, episodes and the arm's clock."""
        flow, dataset = Flow("collect"), Dataset(self._out)
        touch, motion = flow.source(self.touch, "touch"), flow.source(self._motion, "motion")
        samples = (touch | Zero()) & (motion | DeviceClock()) | Align(within=20 * ms)
        label = replace(PAPER_LABEL, delay=self.path.plan.label_delay)
        touch.to(dataset)
        motion.to(dataset)
        (samples | label | MaskLifted(self._series.surface.middle)).to(dataset)
        flow.source(self, "collection").to(dataset)
        touch.to(monitor)
        return flow

    async def _drive(self, monitor: ContactMonitor) -> None:
        """Stay in the air for the baseline, then make each stroke."""
        watching = BackgroundTask("touch", "the watch for samples", self._watch(monitor), self.arm.fail)
        try:
            while not monitor.newest.keys() >= set(self.touch.fingers):
                await self.arm.wait(_POLL)
            monitor.restart()
            await self._follow_as_episode([self.path.plan.path.baseline])
            monitor.set_baseline()
            for stroke in self._series.strokes:
                await self._make(stroke, monitor)
                self.strokes += 1
        finally:
            await watching.end()

    async def _watch(self, monitor: ContactMonitor) -> None:
        """Stop the arm when a fingertip gives no more samples.

        The checks are counted, not the time, so that a stall of the host does not count as silence.
        """
        before, checks = dict[int, int](), Counter[int]()  # newest samples; checks without a new one
        while True:
            for finger in self.touch.fingers:
                newest = monitor.newest.get(finger)
                checks[finger] = checks[finger] + 1 if newest == before.get(finger) else 0
                longest = self.path.plan.limits.sensor_timeout if newest else FIRST_SAMPLE
                if checks[finger] * _POLL > longest:
                    reason = f"fingertip {finger} gave no sample for {longest:g} s (limits.sensor_timeout)"
                    self.arm.fail(reason)
            before = monitor.newest.copy()
            await asyncio.sleep(_POLL)

    async def _follow(self, steps: Sequence[Step]) -> None:
        """Move along a path from the arm's pose."""
        for step in steps:
            match step:
                case Line(poses, speed, acceleration):
                    seconds = step.seconds(self.arm.state.pose)
                    await self.arm.line(poses, speed, acceleration, seconds)
                case Turn(spin, time, acceleration):
                    await self.arm.turn(spin, time, acceleration)
                case standstill:
                    await self.arm.wait(standstill)

    async def _make(self, stroke: Stroke, monitor: ContactMonitor) -> None:
        await self._follow(stroke.approach)
        monitor.restart()
        await self._follow_as_episode(stroke.contact, stroke)
        without_contact = monitor.without_contact()
        await self._follow(stroke.retreat)
        if without_contact and self.path.plan.limits.require_contact:
            self.arm.fail(
                f"fingertip {without_contact[0]} measured no contact in a stroke: at the start, or at the"
                " planned pose, it must just touch the surface (limits.require_contact = false ignores this)"
            )
            await self.arm.wait(_POLL)  # raises

    async def _follow_as_episode(self, steps: Sequence[Step], stroke: Stroke | None = None) -> None:
        """Follow steps as an episode; `stroke` None: the baseline."""
        start = self.clock.now()
        try:
            await self._follow(steps)
        finally:
            end = max(self.clock.now(), start + 1)
            self._episodes.put_nowait(_episode(self._series, stroke, start, end))


def _episode(series: StrokeSeries, stroke: Stroke | None, start: int, end: int) -> Episodes:
    """Return an episode from `start` to `end` (ns) as a row; `stroke` None: the baseline."""
    move, depth = Move("hold", (end - start) / s), math.nan
    if stroke:
        kind: MotionKind = "rotation" if series.speed is None else "translation"
        degrees, depth = math.degrees(stroke.direction), series.plan.path.depth
        move = replace(move, motion=kind, direction_deg=degrees, speed=stroke.speed)
    row = episode(move, 0.0, start, Scene(curvature=series.surface.shape))
    return replace(row, end=np.array([end]), depth=np.array([depth]))


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
    scene = Scene((), surface.shape, surface.radius, vibration=Vibration())
    return SimulatedArm(scene, surface.middle, path.bounds, clock, seed=plan.seed, fingers=fingers)
