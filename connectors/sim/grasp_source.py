"""Live source of a simulated grasp, and sink for its commands."""

import asyncio
import math
from collections.abc import AsyncIterator
from dataclasses import replace
from itertools import count
from typing import TYPE_CHECKING, Final

from connectors.sim.grasp_actions import Lift
from connectors.sim.objects import Object
from operators.batch import Commands, Touch, s
from operators.fingertip import TAKKTILE, Fingertip
from operators.ports import Clock, Description, Run, Sink, Source

if TYPE_CHECKING:
    from connectors.sim.grasp import Grasp

PERIOD: Final = s // 100  # ns
UP: Final = Lift(3.0)  # default lift; leaves time for the baseline


class SimulatedGrasp(Source[Touch]):
    """Touch of a simulated grasp, with a sink for commands, `hand`.

    The hand is open until a force is commanded. It moves up at the instant of its lift, even if it is empty.

    Args:
        held: The object.
        seed: Random seed of the cells' rest levels and of all noise.
        lift: Lift of the hand (default 3 s after the start of the run).

    Attributes:
        hand: Sink of commands to the hand.
        grasp: Grasp of the latest run; None before the first.
    """

    def __init__(self, held: Object, seed: int = 0, *, lift: Lift = UP) -> None:
        self.held, self.seed, self.lift = held, seed, lift
        self.hand = Hand(self)
        self.grasp: Grasp | None = None
        self._origin = 0  # ns

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
        await asyncio.to_thread(lambda: self._open().sense(PERIOD / s))

    async def batches(self, clock: Clock) -> AsyncIterator[Touch]:
        """Yield a sample every 10 ms."""
        origin = self._origin = clock.now()
        grasp = self.grasp = self._open()
        for number in count():
            await clock.sleep_until(origin + number * PERIOD)
            touch, _ = grasp.sense(number * PERIOD / s)
            yield replace(touch, time=touch.time + origin)

    @property
    def fingertip(self) -> Fingertip:
        """A TakkTile."""
        return replace(TAKKTILE, rate=s / PERIOD)

    def describe(self) -> Description:
        """Return sensor, object and seed."""
        return {"sensor": "TakkTile 2x3, simulated", "object": self.held.name, "seed": self.seed}

    def command(self, commands: Commands) -> None:
        """Apply commands from their own times on; without a run, or with a NaN force, they have no effect."""
        for time, force in zip(commands.time.tolist(), commands.force.tolist(), strict=True):
            if self.grasp is not None and not math.isnan(force):
                self.grasp.press(max(force, 0.0), (time - self._origin) / s)

    def _open(self) -> "Grasp":
        from connectors.sim.grasp import Grasp

        return Grasp(self.held, seed=self.seed, lift=self.lift)


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

    def take(self, batch: Commands) -> bool:
        """Apply commands from their own times on."""
        self._grasping.command(batch)
        return True
