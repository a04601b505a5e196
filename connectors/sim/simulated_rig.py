"""Simulated rig: live sources of a fingertip, an arm and their ground truth."""

from collections.abc import AsyncIterator, Callable
from dataclasses import asdict, replace
from functools import partial
from itertools import count
from math import nan, radians
from typing import Any, Final

import numpy as np

from connectors.sim.scene import Move, Scene, Timing, Vibration
from operators.batch import EVERY, MOTIONS, SURFACES, AnyBatch, Batch, Episodes, Motion, Touch, Truth, ms, s
from operators.checks import check_at_least
from operators.fingertip import TAKKTILE, Fingertip
from operators.ports import Clock, Description, Source

SENSOR: Final = "TakkTile 2x3, simulated"
SLIDING: Final = 0.003  # m/s, true sliding that counts as slip; as in the paper's labels
SLIDING_SPAN: Final = 150 * ms  # ns; a slip has pauses of 50 to 100 ms, in which the contact sticks


class SimulatedSource(Source[AnyBatch]):
    """Stream of a simulation.

    Args:
        name: Name in drawings of a flow.
        kind: Type of the batches.
        rows: Generator of the batches in the time of a clock.
        about: Description for recordings.
        fingers: Fingertips that the batches belong to.
        rate: Samples of a fingertip per second, Hz; None: not touch.
        stale_after: As in `Source`.
    """

    def __init__(
        self,
        name: str,
        kind: type[AnyBatch],
        rows: Callable[[Clock], AsyncIterator[AnyBatch]],
        about: Description,
        *,
        fingers: tuple[int, ...] = (EVERY,),
        rate: float | None = None,
        stale_after: int | None = Source.stale_after,
    ) -> None:
        self._name, self._kind, self._rows, self._about = name, kind, rows, about
        self._fingers, self._rate, self.stale_after = fingers, rate, stale_after

    def __str__(self) -> str:
        return f"{self._name}()"

    @property
    def kind(self) -> type[AnyBatch]:
        """Type of the batches."""
        return self._kind

    @property
    def fingers(self) -> tuple[int, ...]:
        """Fingertips that the batches belong to."""
        return self._fingers

    @property
    def fingertip(self) -> Fingertip | None:
        """A TakkTile, or None if this is not touch."""
        return None if self._rate is None else replace(TAKKTILE, rate=self._rate)

    def prepare(self) -> None:
        """Compile the physics of strokes, which takes seconds the first time and less than one afterwards."""
        from connectors.sim.finger import compile_physics

        compile_physics()

    def batches(self, clock: Clock) -> AsyncIterator[AnyBatch]:
        """Yield the rows."""
        return self._rows(clock)

    def describe(self) -> Description:
        """Return the description."""
        return self._about


class SimulatedRig:
    """A simulated scene as sources that share one run.

    `touch` and `motion` are the streams of the hardware, `episodes` the moves of the arm at their starts, and
    `truth` the ground truth at each touch sample.

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
        self.scene = scene = scene if scene is not None else Scene(vibration=Vibration())
        self.seed = seed
        fingertip: Description = {
            "sensor": SENSOR, "rig": "simulated", "seed": seed, "scene": asdict(scene),
        }  # fmt: skip
        arm: Description = {"arm": "UR10, simulated", "rate_hz": scene.motion.rate, "seed": seed}
        touch, rate = partial(self._rows, Touch, scene.touch), scene.touch.rate
        self.touch = SimulatedSource("SimulatedTouch", Touch, touch, fingertip, fingers=(0,), rate=rate)
        motion = partial(self._rows, Motion, scene.motion)
        self.motion = SimulatedSource("SimulatedMotion", Motion, motion, arm)
        # moves are rare, and the touch of the truth has a status of its own
        self.episodes = SimulatedSource("SimulatedEpisodes", Episodes, self._episodes, {}, stale_after=None)
        truth = partial(self._rows, Truth, scene.touch)
        self.truth = SimulatedSource("SimulatedTruth", Truth, truth, {}, fingers=(0,), stale_after=None)
        self._origin = 0  # ns
        self._running = set[type[Batch]]()  # types of the streams

    def _begin(self, kind: type[Batch], clock: Clock) -> int:
        """Add a stream to the current run, or to a new run if already added; return the origin (ns)."""
        if not self._running or kind in self._running:
            self._running, self._origin = set(), clock.now()
        self._running.add(kind)
        return self._origin

    async def _rows(self, kind: type[AnyBatch], timing: Timing, clock: Clock) -> AsyncIterator[AnyBatch]:
        """Yield the samples of a stream, one at a time, as they arrive."""
        origin, take = self._begin(kind, clock), self._sampler(kind)
        for number in count():
            await clock.sleep_until(origin + round((number / timing.rate + timing.latency) * s))
            if (batch := take()) is None:
                return
            if len(batch):
                yield batch.later(origin)

    def _sampler(self, kind: type[Batch]) -> Callable[[], Any]:
        """Return a function that gives the next sample of a stream; None at the end of the plan."""
        from connectors.sim.arm_motion import Controller
        from connectors.sim.finger import Finger

        if kind is Motion:
            controller = Controller(self.scene, self.seed)
            return lambda: controller.take(1)
        fingertip, part = Finger(self.scene, self.seed), 0 if kind is Touch else 1
        return lambda: (taken := fingertip.take(1)) and taken[part]

    async def _episodes(self, clock: Clock) -> AsyncIterator[Episodes]:
        """Yield each move of the arm when it begins."""
        origin = self._begin(Episodes, clock)
        for start, move in self.scene.moves(self.seed):
            await clock.sleep_until(origin + round(start * s))
            yield episode(move, start, origin, self.scene)


async def ticks(clock: Clock, origin: int, period: int) -> AsyncIterator[int]:
    """Yield the times (ns) of a schedule from now on, each when the clock reaches it."""
    for number in count(max(0, -((origin - clock.now()) // period))):
        await clock.sleep_until(origin + number * period)
        yield origin + number * period


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
    """Return onset and end (ns) of every true slip; short sticks are part of a slip.

    A slip moves by more than 0.45 mm, as the labels of true sliding demand: 3 mm/s in the mean over 150 ms.
    """
    time, rows = truth.time, np.flatnonzero(truth.sliding > SLIDING)  # (n,), (k,)
    if not len(rows):
        return []
    breaks = np.flatnonzero(np.diff(time[rows]) > SLIDING_SPAN)
    spans = zip(rows[np.r_[0, breaks + 1]].tolist(), rows[np.r_[breaks, -1]].tolist(), strict=True)
    moved = truth.sliding * np.diff(time, prepend=time[:1])  # (n,) nm
    far = [(begin, end) for begin, end in spans if moved[begin : end + 1].sum() > SLIDING * SLIDING_SPAN]
    return [(time.item(begin), time.item(end)) for begin, end in far]
