"""Live source of a simulated grasp, and sink for its commands."""

import asyncio
import math
from collections.abc import AsyncIterator, Sequence
from dataclasses import replace
from itertools import count
from typing import TYPE_CHECKING, Final

from connectors.sim.grasp_actions import Lift, Tap
from connectors.sim.objects import Object
from operators.batch import Commands, Touch, s
from operators.errors import ParameterError
from operators.ports import Clock, Description, Run, Sink, Source

if TYPE_CHECKING:
    from connectors.sim.grasp import Grasp, GraspState

PERIOD: Final = s // 100  # ns
UP: Final = Lift(3.0)  # default lift; leaves time for the baseline


class SimulatedGrasp:
    """A simulated grasp with a source, `touch`, and a sink for commands, `hand`.

    The hand is open until a force is commanded. It moves up at the instant of its lift, even if it is empty.

    Args:
        held: The object.
        seed: Random seed of the cells' rest levels and of all noise.
        lift: Lift of the hand (default 3 s after the start of the run).
        taps: Mallet blows on the object.
        seconds: Duration of the touch stream (s); None for no end.

    Attributes:
        states: True state at each sample of the latest run.

    Raises:
        ParameterError: if `seconds` is not above 0.
    """

    def __init__(
        self,
        held: Object,
        seed: int = 0,
        *,
        lift: Lift = UP,
        taps: Sequence[Tap] = (),
        seconds: float | None = None,
    ) -> None:
        if seconds is not None and not seconds > 0:
            raise ParameterError("SimulatedGrasp", "seconds", seconds, "above 0, or None")
        self.held, self.seed, self.lift, self.taps, self.seconds = held, seed, lift, tuple(taps), seconds
        self.touch, self.hand = GraspTouch(self), Hand(self)
        self.states: list[GraspState] = []
        self._origin = 0  # ns
        self._grasp: Grasp | None = None

    def begin(self, origin: int) -> "Grasp":
        """Begin a run at `origin` (ns) and return its grasp, without commands."""
        self._origin, self._grasp = origin, opened(self.held, self.seed, self.lift, self.taps)
        self.states.clear()
        return self._grasp

    def command(self, commands: Commands) -> None:
        """Apply commands from their own times on; without a run they have no effect."""
        if self._grasp is not None:
            press(self._grasp, commands, self._origin)


class GraspTouch(Source[Touch]):
    """Source of the touch of the fingertip."""

    def __init__(self, grasping: SimulatedGrasp) -> None:
        self._grasping = grasping

    @property
    def kind(self) -> type[Touch]:
        """Type of the batches: raw counts."""
        return Touch

    @property
    def fingers(self) -> tuple[int, ...]:
        """Number of the only fingertip, 0."""
        return (0,)

    async def prepare(self) -> None:
        """Compile the physics, which takes seconds the first time and less than one afterwards."""
        grasping = self._grasping
        await asyncio.to_thread(
            lambda: opened(grasping.held, 0, grasping.lift, grasping.taps).sense(PERIOD / s)
        )

    async def batches(self, clock: Clock) -> AsyncIterator[Touch]:
        """Yield a sample every 10 ms."""
        grasping, origin = self._grasping, clock.now()
        grasp = grasping.begin(origin)
        for number in count() if grasping.seconds is None else range(round(grasping.seconds * s / PERIOD)):
            await clock.sleep_until(origin + number * PERIOD)
            touch, state = grasp.sense(number * PERIOD / s)
            grasping.states.append(state)
            yield replace(touch, time=touch.time + origin)

    def describe(self) -> Description:
        """Return sensor, object and seed."""
        grasping = self._grasping
        return {
            "sensor": "TakkTile 2x3, simulated",
            "rate_hz": s / PERIOD,
            "object": grasping.held.name,
            "seed": grasping.seed,
        }


class Hand(Sink[Commands]):
    """Sink of commands to the hand."""

    def __init__(self, grasping: SimulatedGrasp) -> None:
        self._grasping = grasping

    @property
    def destination(self) -> str:
        """Unique name of the hand, so that a flow can detect a second sink for it."""
        return f"hand around a {self._grasping.held.name} {id(self._grasping):x}"

    async def open(self, run: Run) -> None:
        """Accept any run."""
        del run

    async def write(self, batch: Commands) -> None:
        """Apply commands from their own times on."""
        self._grasping.command(batch)


def opened(held: Object, seed: int, lift: Lift, taps: Sequence[Tap] = ()) -> "Grasp":
    """Return a grasp whose hand is open until it is commanded."""
    from connectors.sim.grasp import Grasp  # noqa: PLC0415 - loads numba: only to run

    return Grasp(held, seed=seed, force=0.0, closing=0.0, lift=lift, taps=taps)


def press(grasp: "Grasp", commands: Commands, origin: int) -> None:
    """Apply commands to a grasp that began at `origin` (ns); a NaN force has no effect."""
    for time, force in zip(commands.time.tolist(), commands.force.tolist(), strict=True):
        if not math.isnan(force):
            grasp.press(max(force, 0.0), (time - origin) / s)
