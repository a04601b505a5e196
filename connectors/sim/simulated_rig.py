"""Simulated rig: live sources of fingertips and an arm, and a sink of arm and gripper commands."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from dataclasses import fields, is_dataclass, replace
from itertools import count
from math import inf, nan, radians
from typing import Any, Final, Generic, cast

import numpy as np

from connectors.sim.commanded_motion import CommandQueue
from connectors.sim.scene import Move, Scene, Timing
from operators.batch import EVERY, MOTIONS, SURFACES, AnyBatch, Commands, Episodes, Motion, Touch, Truth, s
from operators.errors import ParameterError
from operators.ports import Clock, Description, Json, Run, Sink, Source

UNPACED_BATCH: Final = 5.0  # s of samples per batch of an unpaced run; joins buffer motion for longer


class SimulatedRig:
    """A simulated scene with synchronous sources, and a sink for commands, `hand`.

    `touch` and `motion` are the streams of the hardware, `episodes` the moves of the arm at their starts, and
    `truth` the ground truth at each touch sample. The last two need `touch` in the same flow.

    A run begins with the first iteration over a source; a second iteration over the same source begins a new
    run. With the same seed, runs are identical except for the start of their timestamps.

    Args:
        scene: Scene to simulate (default `Scene()`: presses and strokes without end).
        seed: Random seed; the same seed gives identical output.
        pace: Simulated seconds per second of the clock (default 1); None for as fast as possible, in large
            batches.
        fingers: Fingertips that share one motion, each with its own noise and cells.

    Raises:
        ParameterError: if the pace is not above 0, or there is no fingertip.

    >>> rig = SimulatedRig(seed=1)
    >>> rig.touch.kind.__name__, rig.motion.kind.__name__, rig.touch.fingers
    ('Touch', 'Motion', (0,))
    """

    def __init__(
        self,
        scene: Scene | None = None,
        seed: int = 0,
        *,
        pace: float | None = 1.0,
        fingers: tuple[int, ...] = (0,),
    ) -> None:
        if pace is not None and not pace > 0:
            raise ParameterError("SimulatedRig", "pace", pace, "above 0, or None for as fast as possible")
        if not fingers:
            raise ParameterError("SimulatedRig", "fingers", fingers, "at least one fingertip")
        self.scene = scene if scene is not None else Scene()
        self.seed, self.pace, self.fingers = seed, pace, fingers
        self.touch = SimulatedTouch(self)
        self.motion = SimulatedMotion(self)
        self.hand = SimulatedHand(self)
        self.commands = CommandQueue()
        self.episodes = GroundTruth(self, Episodes, (EVERY,))
        self.truth = GroundTruth(self, Truth, fingers)
        self._origin = 0  # ns
        self._running: set[Source[Any]] = set()
        self._batches: dict[Source[Any], float] = {}  # number of batches of each source, if not paced
        self._advanced = asyncio.Event()

    def describe(self) -> Description:
        """Return the description of the rig for recordings."""
        return {
            "rig": "simulated",
            "seed": self.seed,
            "fingers": list(self.fingers),
            "scene": _json(self.scene),
        }

    def begin(self, source: Source[Any], clock: Clock) -> int:
        """Add a source to the current run, or to a new run if already added; return the origin (ns)."""
        if not self._running or source in self._running:
            self._running, self._batches, self._advanced = set(), {}, asyncio.Event()
            self._origin = clock.now()
            self.commands.begin(self._origin)
            for each in (self.episodes, self.truth):
                each.restart()
        self._running.add(source)
        return self._origin

    def schedule(self, timing: Timing) -> Iterator[tuple[int, int]]:
        """Yield the time at which samples of a stream are due (ns), and their number."""
        if self.pace is None:
            while True:
                yield self._origin, max(1, round(UNPACED_BATCH * timing.rate))
        for taken in count():
            yield self._origin + round((taken / timing.rate + timing.latency) / self.pace * s), 1

    async def wait_for_others(self, source: Source[Any]) -> None:
        """Synchronise touch and motion of an unpaced run, with the motion ahead."""
        batches = self._batches[source] = self._batches.get(source, -1) + 1
        self._advanced.set()
        await asyncio.sleep(0)  # the other source may not have begun yet
        least = batches + (source is self.touch)
        others = self._running & {self.touch, self.motion} - {source}
        while any(self._batches.get(other, 0) < least for other in others):
            self._advanced.clear()
            await self._advanced.wait()

    def end(self, source: Source[Any]) -> None:
        """Mark a source as ended, so that no other waits for it; end the annotations with the touch."""
        self._batches[source] = inf
        self._advanced.set()
        if source is self.touch:
            self.episodes.end()
            self.truth.end()

    def add_truth(self, truth: Truth) -> None:
        """Publish the ground truth of a fingertip, timestamped from the run's start."""
        if self.truth in self._running and len(truth):
            self.truth.add(replace(truth, time=truth.time + self._origin))

    def add_move(self, move: Move, start: float) -> None:
        """Publish a move that begins at `start` (s since the run began) as an episode."""
        if self.episodes in self._running:
            begin, end = (self._origin + round(at * s) for at in (start, start + move.seconds))
            self.episodes.add(episode(move, begin, end, self.scene))


class SimulatedTouch(Source[Touch]):
    """Source of the simulated fingertips, created by `SimulatedRig`."""

    def __init__(self, rig: SimulatedRig) -> None:
        self._rig = rig

    @property
    def kind(self) -> type[Touch]:
        """Type of the batches: raw counts."""
        return Touch

    @property
    def fingers(self) -> tuple[int, ...]:
        """Fingertips of the rig."""
        return self._rig.fingers

    async def prepare(self) -> None:
        """Compile the physics, which takes seconds the first time and less than one afterwards."""
        from connectors.sim.finger import compile_physics  # noqa: PLC0415 - loads numba: only to run

        await asyncio.to_thread(compile_physics)

    async def batches(self, clock: Clock) -> AsyncIterator[Touch]:
        """Yield samples of each fingertip in turn, one at a time when paced."""
        rig = self._rig
        origin = rig.begin(self, clock)
        await asyncio.sleep(0)  # lets the annotations begin before the first move
        from connectors.sim.finger import Finger  # noqa: PLC0415 - loads numba: only to run

        callbacks = [rig.add_move, *[None] * len(rig.fingers)]
        fingers = [
            Finger(rig.scene, rig.seed, finger, on_move, rig.commands)
            for finger, on_move in zip(rig.fingers, callbacks, strict=False)
        ]
        try:
            for due, samples in rig.schedule(rig.scene.touch):
                await (rig.wait_for_others(self) if rig.pace is None else clock.sleep_until(due))
                for simulation in fingers:
                    if (taken := simulation.take(samples)) is None:
                        return
                    touch, truth = taken
                    rig.add_truth(truth)
                    if len(touch):
                        yield replace(touch, time=touch.time + origin)
        finally:
            rig.end(self)

    def describe(self) -> Description:
        """Return the rig and the rate of this stream."""
        timing = self._rig.scene.touch
        return {"sensor": "TakkTile 2x3, simulated", "rate_hz": timing.rate, **self._rig.describe()}


class SimulatedMotion(Source[Motion]):
    """Source of the simulated arm's motion, created by `SimulatedRig`."""

    def __init__(self, rig: SimulatedRig) -> None:
        self._rig = rig

    @property
    def kind(self) -> type[Motion]:
        """Type of the batches: motion reported by the arm's controller."""
        return Motion

    async def prepare(self) -> None:
        """Compile the physics."""
        await self._rig.touch.prepare()

    async def batches(self, clock: Clock) -> AsyncIterator[Motion]:
        """Yield samples of the arm, one at a time when paced."""
        rig = self._rig
        origin = rig.begin(self, clock)
        from connectors.sim.arm_motion import Controller  # noqa: PLC0415 - loads numba: only to run

        controller = Controller(rig.scene, rig.seed, rig.commands)
        try:
            for due, samples in rig.schedule(rig.scene.motion):
                await (rig.wait_for_others(self) if rig.pace is None else clock.sleep_until(due))
                if (motion := controller.take(samples)) is None:
                    return
                if len(motion):
                    yield replace(motion, time=motion.time + origin)
        finally:
            rig.end(self)

    def describe(self) -> Description:
        """Return the arm and the rate of this stream."""
        rig = self._rig
        return {"arm": "UR10, simulated", "rate_hz": rig.scene.motion.rate, "seed": rig.seed}


class GroundTruth(Source[AnyBatch], Generic[AnyBatch]):
    """Source of ground truth that the touch source simulates, created by `SimulatedRig`."""

    def __init__(self, rig: SimulatedRig, kind: type[AnyBatch], fingers: tuple[int, ...]) -> None:
        self._rig, self._kind, self._fingers = rig, kind, fingers
        self.restart()

    @property
    def kind(self) -> type[AnyBatch]:
        """Type of the batches: Episodes or Truth."""
        return self._kind

    @property
    def fingers(self) -> tuple[int, ...]:
        """Fingertips of the rig, or EVERY for episodes."""
        return self._fingers

    async def batches(self, clock: Clock) -> AsyncIterator[AnyBatch]:
        """Yield batches until the touch source ends."""
        self._rig.begin(self, clock)
        rows = self._rows
        while (batch := await rows.get()) is not None:
            yield batch

    def restart(self) -> None:
        """Drop the batches of an earlier run."""
        self._rows = asyncio.Queue[AnyBatch | None]()

    def add(self, batch: AnyBatch) -> None:
        """Queue a batch."""
        self._rows.put_nowait(batch)

    def end(self) -> None:
        """End the stream."""
        self._rows.put_nowait(None)


def episode(move: Move, start: int, end: int, scene: Scene) -> Episodes:
    """Return a move as a row of episodes; `start` and `end` are in ns."""
    speed, angular_speed = (0.0, move.speed) if move.motion == "rotation" else (move.speed, 0.0)
    force = nan if move.force is None else move.force
    return Episodes(
        np.array([start]),
        np.array([end]),
        np.array([MOTIONS.index(move.motion)], np.int8),
        np.array([SURFACES.index(scene.curvature)], np.int8),
        *(np.array([value]) for value in (radians(move.direction_deg), speed, angular_speed, nan, force)),
    )


class SimulatedHand(Sink[Commands]):
    """Sink of commands to the simulated gripper and arm; see `connectors.sim.commanded_motion`."""

    def __init__(self, rig: SimulatedRig) -> None:
        self._rig = rig

    @property
    def destination(self) -> str:
        """Unique name of the rig, so that a flow can detect a second sink for it."""
        return f"hand of the rig {id(self._rig):x}"

    async def open(self, run: Run) -> None:
        """Discard the commands of an earlier run.

        Raises:
            ParameterError: if the rig is not paced, because commands would arrive too late.
        """
        del run
        if self._rig.pace is None:
            raise ParameterError("SimulatedRig", "pace", None, "above 0 if a flow commands the rig")
        self._rig.commands.setpoints.clear()

    async def write(self, batch: Commands) -> None:
        """Apply commands from their own times on."""
        self._rig.commands.add(batch)


def _json(value: object) -> Json:
    """Return parameters as JSON data."""
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: _json(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, tuple):
        return [_json(item) for item in cast("tuple[object, ...]", value)]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return repr(value)
