"""Simulated rig: live sources of a fingertip, an arm and their ground truth."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import asdict, replace
from itertools import count
from math import nan, radians
from typing import Any, Final

import numpy as np

from connectors.sim.scene import Move, Scene, Timing, Vibration
from operators.batch import EVERY, MOTIONS, SURFACES, AnyBatch, Episodes, Motion, Touch, Truth, s
from operators.checks import check_at_least
from operators.fingertip import TAKKTILE, Fingertip
from operators.ports import Clock, Description, Source
from operators.sliding_motion import SlidingMotion

SLIDING: Final = SlidingMotion.speed  # m/s, true sliding that counts as slip


class SimulatedRig:
    """A simulated scene as sources that share one run.

    `touch` and `motion` are the streams of the hardware, `episodes` the moves of the arm at their starts, and
    `truth` the ground truth at each touch sample, which needs `touch` in the same flow.

    A run begins with the first iteration over a source; a second iteration over the same source begins a new
    run. With the same seed, runs are identical except for the start of their timestamps.

    Args:
        scene: Scene to simulate (default: presses and strokes without end, by an arm that vibrates).
        seed: Random seed; the same seed gives identical output.

    Raises:
        ParameterError: if the seed is below 0.

    >>> rig = SimulatedRig(seed=1)
    >>> rig.touch.kind.__name__, rig.motion.kind.__name__, rig.touch.fingers
    ('Touch', 'Motion', (0,))
    """

    def __init__(self, scene: Scene | None = None, seed: int = 0) -> None:
        check_at_least("SimulatedRig", "seed", seed, 0)
        self.scene = scene if scene is not None else Scene(vibration=Vibration())
        self.seed = seed
        self.touch = SimulatedTouch(self, Touch, (0,))
        self.motion = SimulatedMotion(self, Motion, (EVERY,))
        self.episodes = SimulatedEpisodes(self, Episodes, (EVERY,))
        self.truth = SimulatedTruth(self, Truth, (0,))
        self._origin = 0  # ns
        self._running: set[Source[Any]] = set()

    def describe(self) -> Description:
        """Return the description of the rig for recordings."""
        return {"rig": "simulated", "seed": self.seed, "scene": asdict(self.scene)}

    def begin(self, source: Source[Any], clock: Clock) -> int:
        """Add a source to the current run, or to a new run if already added; return the origin (ns)."""
        if not self._running or source in self._running:
            self._running, self._origin = set(), clock.now()
        self._running.add(source)
        return self._origin

    async def arrivals(self, timing: Timing, clock: Clock) -> AsyncIterator[None]:
        """Yield at the arrival of each sample of a stream."""
        for number in count():
            await clock.sleep_until(self._origin + round((number / timing.rate + timing.latency) * s))
            yield


class _RigStream(Source[AnyBatch]):
    """Stream of a rig."""

    def __init__(self, rig: SimulatedRig, kind: type[AnyBatch], fingers: tuple[int, ...]) -> None:
        self._rig, self._kind, self._fingers = rig, kind, fingers

    @property
    def kind(self) -> type[AnyBatch]:
        """Type of the batches."""
        return self._kind

    @property
    def fingers(self) -> tuple[int, ...]:
        """The only fingertip, 0, or EVERY for the arm."""
        return self._fingers

    async def prepare(self) -> None:
        """Compile the physics, which takes seconds the first time and less than one afterwards."""
        from connectors.sim.finger import compile_physics  # noqa: PLC0415 - loads numba: only to run

        await asyncio.to_thread(compile_physics)


class SimulatedTouch(_RigStream[Touch]):
    """Source of the simulated fingertip, created by `SimulatedRig`."""

    async def batches(self, clock: Clock) -> AsyncIterator[Touch]:
        """Yield samples, one at a time."""
        rig, origin = self._rig, self._rig.begin(self, clock)
        await asyncio.sleep(0)  # lets the truth begin before the first sample
        from connectors.sim.finger import Finger  # noqa: PLC0415 - loads numba: only to run

        fingertip = Finger(rig.scene, rig.seed)
        try:
            async for _ in rig.arrivals(rig.scene.touch, clock):
                if (taken := fingertip.take(1)) is None:
                    return
                touch, truth = taken
                if len(touch):
                    rig.truth.add(replace(truth, time=truth.time + origin))
                    yield replace(touch, time=touch.time + origin)
        finally:
            rig.truth.end()

    @property
    def fingertip(self) -> Fingertip:
        """A TakkTile at the rate of the scene."""
        return replace(TAKKTILE, rate=self._rig.scene.touch.rate)

    def describe(self) -> Description:
        """Return the rig."""
        return {"sensor": "TakkTile 2x3, simulated", **self._rig.describe()}


class SimulatedMotion(_RigStream[Motion]):
    """Source of the simulated arm's motion, created by `SimulatedRig`."""

    async def batches(self, clock: Clock) -> AsyncIterator[Motion]:
        """Yield samples of the arm, one at a time."""
        rig, origin = self._rig, self._rig.begin(self, clock)
        from connectors.sim.arm_motion import Controller  # noqa: PLC0415 - loads numba: only to run

        controller = Controller(rig.scene, rig.seed)
        async for _ in rig.arrivals(rig.scene.motion, clock):
            if (motion := controller.take(1)) is None:
                return
            if len(motion):
                yield replace(motion, time=motion.time + origin)

    def describe(self) -> Description:
        """Return the arm and the rate of this stream."""
        rig = self._rig
        return {"arm": "UR10, simulated", "rate_hz": rig.scene.motion.rate, "seed": rig.seed}


class SimulatedEpisodes(_RigStream[Episodes]):
    """Source of the moves of the arm, created by `SimulatedRig`."""

    stale_after = None  # episodes are rare

    async def batches(self, clock: Clock) -> AsyncIterator[Episodes]:
        """Yield each move when it begins."""
        rig, origin = self._rig, self._rig.begin(self, clock)
        for start, move in rig.scene.moves(rig.seed):
            await clock.sleep_until(origin + round(start * s))
            yield episode(move, start, origin, rig.scene)


class SimulatedTruth(_RigStream[Truth]):
    """Source of the ground truth that the touch source simulates, created by `SimulatedRig`."""

    stale_after = None  # an annotation of the touch, which has its own status
    _rows: asyncio.Queue[Truth | None] | None = None  # of the current run

    async def batches(self, clock: Clock) -> AsyncIterator[Truth]:
        """Yield the truth of each touch sample until the touch source ends."""
        self._rig.begin(self, clock)
        rows = self._rows = asyncio.Queue()
        while (truth := await rows.get()) is not None:
            yield truth

    def add(self, truth: Truth) -> None:
        """Queue the truth of a sample, if this source is running."""
        if self._rows is not None:
            self._rows.put_nowait(truth)

    def end(self) -> None:
        """End the stream."""
        if self._rows is not None:
            self._rows.put_nowait(None)
            self._rows = None


def episode(move: Move, start: float, origin: int, scene: Scene) -> Episodes:
    """Return a move that begins at `start` (s since `origin`, ns) as a row of episodes."""
    speed, angular_speed = (0.0, move.speed) if move.motion == "rotation" else (move.speed, 0.0)
    force = nan if move.force is None else move.force
    return Episodes(
        np.array([origin + round(start * s)]),
        np.array([origin + round((start + move.seconds) * s)]),
        np.array([MOTIONS.index(move.motion)], np.int8),
        np.array([SURFACES.index(scene.curvature)], np.int8),
        *(np.array([value]) for value in (radians(move.direction_deg), speed, angular_speed, nan, force)),
    )


def true_slips(truth: Truth) -> list[tuple[int, int]]:
    """Return onset and end (ns) of every true slip; short sticks are part of a slip."""
    at = truth.time[truth.sliding > SLIDING]  # (k,)
    if not len(at):
        return []
    breaks = np.flatnonzero(np.diff(at) > SlidingMotion.stick)
    starts, ends = at[np.r_[0, breaks + 1]], at[np.r_[breaks, -1]]
    return list(zip(starts.tolist(), ends.tolist(), strict=True))
