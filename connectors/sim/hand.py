"""Simulated hand around an object: sink of grip commands, and live source of its fingertip."""

import math
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, Final

from connectors.sim.objects import Object
from connectors.sim.scene import Travel
from connectors.sim.simulated_rig import SENSOR, SimulatedSource, ticks
from operators.batch import Commands, Touch, s
from operators.ports import Clock, Description, Run, Sink

if TYPE_CHECKING:
    from connectors.sim.grasp import Grasp

PERIOD: Final = s // 100  # ns
LIFT: Final = Travel(4.5)  # leaves time for the baseline and the window of a detector


class Hand(Sink[Commands]):
    """Hand around an object; it is open until a force is commanded, and moves up at 3 s even if empty.

    Args:
        held: The object.
        seed: Random seed of the cells' rest levels and of all noise.

    Attributes:
        touch: Source of the samples of its fingertip.
        grasp: Grasp of the latest run; None before the first.
    """

    def __init__(self, held: Object, seed: int = 0) -> None:
        self.held, self.seed = held, seed
        about: Description = {"sensor": SENSOR, "object": held.name, "seed": seed}
        self.touch = SimulatedSource(
            "SimulatedGrasp", Touch, self._touch, about, fingers=(0,), rate=s / PERIOD,
            compile_physics=lambda: self._open().sense(PERIOD / s),
        )  # fmt: skip
        self.grasp: Grasp | None = None
        self._origin = 0  # ns

    @property
    def destination(self) -> str:
        """Unique name of the hand, so that a flow can detect a second sink for it."""
        return f"hand around a {self.held.name} {id(self):x}"

    async def open(self, run: Run) -> None:
        """Accept any run."""
        del run

    def take(self, batch: Commands) -> bool:
        """Apply commands from their own times on; without a run, or with a NaN force, they have no effect."""
        for time, force in zip(batch.time.tolist(), batch.force.tolist(), strict=True):
            if self.grasp is not None and not math.isnan(force):
                self.grasp.press(max(force, 0.0), (time - self._origin) / s)
        return True

    async def _touch(self, clock: Clock) -> AsyncIterator[Touch]:
        """Yield a sample every 10 ms."""
        origin = self._origin = clock.now()
        grasp = self.grasp = self._open()
        async for time in ticks(clock, origin, PERIOD):
            touch, _ = grasp.sense((time - origin) / s)
            yield touch.later(origin)

    def _open(self) -> "Grasp":
        from connectors.sim.grasp import Grasp

        return Grasp(self.held, seed=self.seed, lift=LIFT)
