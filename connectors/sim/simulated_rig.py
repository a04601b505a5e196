"""The simulated rig: fingertips and an arm as live sources, its hand as a sink, a peer of the hardware."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from dataclasses import fields, is_dataclass, replace
from itertools import count
from math import inf
from typing import Any, Final, cast

from connectors.sim.hand import Orders
from connectors.sim.moved import Moved
from connectors.sim.scene import Move, Scene, Timing
from connectors.sim.truth import Memory, Truth
from operators.batch import Commands, Motion, Touch, s
from operators.errors import ParameterError
from operators.ports import Clock, Description, Json, Run, Sink, Source

STRETCH: Final = 5.0  # s in one batch of a run that is not paced; joins keep motion for longer


class SimulatedRig:
    """A scene as two sources, `touch` and `motion`, that run on one time, and a sink, `hand`, for commands.

    A run begins when the first of the two is asked for its batches, and again when one is asked anew; the
    same seed then gives the same bytes, stamped from the new beginning.

    Args:
        scene: What happens; the default presses and strokes for ever.
        seed: Of the plan, of the cells' individuality and of all noise.
        pace: Simulated seconds per second of the clock; None: as fast as it goes, in large batches.
        fingers: Fingertips that feel the same motion, each with noise and cells of its own.
        remember: Seconds that `truth` reaches back, at least.

    Raises:
        ParameterError: on a pace that is not above 0, or without fingertips.

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
        remember: float = 600.0,
    ) -> None:
        if pace is not None and not pace > 0:
            raise ParameterError("SimulatedRig", "pace", pace, "above 0, or None for as fast as it goes")
        if not fingers:
            raise ParameterError("SimulatedRig", "fingers", fingers, "at least one fingertip")
        self.scene = scene if scene is not None else Scene()
        self.seed, self.pace, self.fingers = seed, pace, fingers
        self.touch = RigTouch(self)
        self.motion = RigMotion(self)
        self.hand = RigHand(self)
        self.orders = Orders()
        self._memory = {finger: Memory(int(remember * self.scene.touch.rate)) for finger in fingers}
        self._moved = Moved(self.scene.curvature)
        self._origin = 0  # ns
        self._running: set[Source[Any]] = set()
        self._given: dict[Source[Any], float] = {}  # batches that each source has given, if not paced
        self._advanced = asyncio.Event()

    def truth(self, finger: int | None = None) -> Truth:
        """What really happened to a fingertip (the first one) in this run, up to its newest touch sample."""
        return self._memory[self.fingers[0] if finger is None else finger].recall(self._origin)

    def describe(self) -> Description:
        """What a recording should say of the rig.

        ``episodes`` is alive: a move is added when it begins, with absolute times (ns); read it at the end.
        """
        return {
            "rig": "simulated",
            "seed": self.seed,
            "fingers": list(self.fingers),
            "scene": _json(self.scene),
            "episodes": self._moved,
        }

    def begin(self, source: Source[Any], clock: Clock) -> int:
        """Origin (ns) of the run that a source takes part in: the present one, if it was not in it."""
        if not self._running or source in self._running:
            self._running, self._given, self._advanced = set(), {}, asyncio.Event()
            self._origin = clock.now()
            self.orders.begin(self._origin)
            self._moved.clear()
            for memory in self._memory.values():
                memory.clear()
        self._running.add(source)
        return self._origin

    def schedule(self, timing: Timing) -> Iterator[tuple[int, int]]:
        """When the next samples of a stream are due (ns), and how many they are."""
        if self.pace is None:
            while True:
                yield self._origin, max(1, round(STRETCH * timing.rate))
        for taken in count():
            yield self._origin + round((taken / timing.rate + timing.latency) / self.pace * s), 1

    async def turn(self, source: Source[Any]) -> None:
        """Wait for this source's turn in a run that is not paced: both advance together, the arm ahead."""
        given = self._given[source] = self._given.get(source, -1) + 1
        self._advanced.set()
        await asyncio.sleep(0)  # at the beginning the other one has yet to be asked
        least = given + (source is self.touch)
        while any(self._given.get(other, 0) < least for other in self._running - {source}):
            self._advanced.clear()
            await self._advanced.wait()

    def end(self, source: Source[Any]) -> None:
        """Nobody need wait for this source any more."""
        self._given[source] = inf
        self._advanced.set()

    def remember(self, finger: int, truth: Truth) -> None:
        """Keep what really happened to a fingertip."""
        self._memory[finger].add(truth)

    def note(self, move: Move, start: float) -> None:
        """Write down a move that begins `start` seconds after the run."""
        begin, end = (self._origin + round(at * s) for at in (start, start + move.seconds))
        self._moved.add(move, begin, end)


class RigTouch(Source[Touch]):
    """The simulated fingertips; made by `SimulatedRig`."""

    def __init__(self, rig: SimulatedRig) -> None:
        self._rig = rig

    def truth(self) -> Truth:
        """Return the true state of the first fingertip, as `SimulatedRig.truth` does."""
        return self._rig.truth()

    @property
    def kind(self) -> type[Touch]:
        """Raw counts."""
        return Touch

    @property
    def fingers(self) -> tuple[int, ...]:
        """The rig's fingertips."""
        return self._rig.fingers

    async def prepare(self) -> None:
        """Compile the physics: seconds the first time, then a fraction of one."""
        from connectors.sim.finger import compile_physics  # noqa: PLC0415 - loads numba: only to run

        await asyncio.to_thread(compile_physics)

    async def batches(self, clock: Clock) -> AsyncIterator[Touch]:
        """Samples of each fingertip in turn: one at a time when paced."""
        rig = self._rig
        origin = rig.begin(self, clock)
        from connectors.sim.finger import Finger  # noqa: PLC0415 - loads numba: only to run

        notes = [rig.note, *[None] * len(rig.fingers)]
        fingers = [
            Finger(rig.scene, rig.seed, finger, note, rig.orders)
            for finger, note in zip(rig.fingers, notes, strict=False)
        ]
        try:
            for due, samples in rig.schedule(rig.scene.touch):
                await (rig.turn(self) if rig.pace is None else clock.sleep_until(due))
                for finger, simulation in zip(rig.fingers, fingers, strict=True):
                    if (taken := simulation.take(samples)) is None:
                        return
                    touch, truth = taken
                    rig.remember(finger, truth)
                    if len(touch):
                        yield replace(touch, time=touch.time + origin)
        finally:
            rig.end(self)

    def describe(self) -> Description:
        """The rig, and the timing of this stream."""
        timing = self._rig.scene.touch
        return {"sensor": "TakkTile 2x3, simulated", "rate_hz": timing.rate, **self._rig.describe()}


class RigMotion(Source[Motion]):
    """The simulated arm; made by `SimulatedRig`."""

    def __init__(self, rig: SimulatedRig) -> None:
        self._rig = rig

    @property
    def kind(self) -> type[Motion]:
        """What the arm's controller reports."""
        return Motion

    async def prepare(self) -> None:
        """Compile the motion, as the touch does."""
        await self._rig.touch.prepare()

    async def batches(self, clock: Clock) -> AsyncIterator[Motion]:
        """Samples of the arm: one at a time when paced."""
        rig = self._rig
        origin = rig.begin(self, clock)
        from connectors.sim.arm_motion import Controller  # noqa: PLC0415 - loads numba: only to run

        controller = Controller(rig.scene, rig.seed, rig.orders)
        try:
            for due, samples in rig.schedule(rig.scene.motion):
                await (rig.turn(self) if rig.pace is None else clock.sleep_until(due))
                if (motion := controller.take(samples)) is None:
                    return
                if len(motion):
                    yield replace(motion, time=motion.time + origin)
        finally:
            rig.end(self)

    def describe(self) -> Description:
        """The arm, and the timing of this stream."""
        rig = self._rig
        return {"arm": "UR10, simulated", "rate_hz": rig.scene.motion.rate, "seed": rig.seed}


class RigHand(Sink[Commands]):
    """The simulated gripper and arm as something to command. See `connectors.sim.hand`."""

    def __init__(self, rig: SimulatedRig) -> None:
        self._rig = rig

    @property
    def destination(self) -> str:
        """The rig's hand: one flow commands it once."""
        return f"hand of the rig {id(self._rig):x}"

    async def open(self, run: Run) -> None:
        """Forget what an earlier run commanded.

        Raises:
            ParameterError: if the rig is not paced: a command would come too late.
        """
        del run
        if self._rig.pace is None:
            raise ParameterError("SimulatedRig", "pace", None, "a number when its hand is commanded")
        self._rig.orders.given.clear()

    async def write(self, batch: Commands) -> None:
        """Obey from the commands' own time on."""
        self._rig.orders.give(batch)


def _json(value: object) -> Json:
    """Declared parameters as plain data."""
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: _json(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, tuple):
        return [_json(item) for item in cast("tuple[object, ...]", value)]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return repr(value)
