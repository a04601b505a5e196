"""A grasp as a live source and a sink."""

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
    from connectors.sim.grasp import Grasp, Held

PERIOD: Final = s // 100  # ns
UP: Final = Lift(3.0)  # when nothing else is said: the first second is the baseline's


class Handling:
    """An object in an open hand, as a source, `touch`, that begins with a run, and a sink, `hand`.

    The hand closes when a force is commanded, and goes up when its lift is due, whatever it holds.

    Args:
        held: What is handled.
        seed: Of the cells' individuality and of all noise.
        lift: The hand's way up, from the beginning of the run.
        taps: Blows on the object, likewise.
        seconds: After which the touch ends; None: it goes on.

    Attributes:
        happened: What really happened in the newest run, sample by sample.

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
            raise ParameterError("Handling", "seconds", seconds, "above 0, or None")
        self.held, self.seed, self.lift, self.taps, self.seconds = held, seed, lift, tuple(taps), seconds
        self.touch, self.hand = HandlingTouch(self), Hand(self)
        self.happened: list[Held] = []
        self._origin = 0  # ns
        self._grasp: Grasp | None = None

    def begin(self, origin: int) -> "Grasp":
        """A new run, in which nothing has been commanded."""
        self._origin, self._grasp = origin, opened(self.held, self.seed, self.lift, self.taps)
        self.happened.clear()
        return self._grasp

    def command(self, commands: Commands) -> None:
        """Obey from the commands' own times on; before a run there is nobody to obey."""
        if self._grasp is not None:
            press(self._grasp, commands, self._origin)


class HandlingTouch(Source[Touch]):
    """The fingertip; made by `Handling`."""

    def __init__(self, handling: Handling) -> None:
        self._handling = handling

    @property
    def kind(self) -> type[Touch]:
        """Raw counts."""
        return Touch

    @property
    def fingers(self) -> tuple[int, ...]:
        """One."""
        return (0,)

    async def prepare(self) -> None:
        """Compile the physics: seconds the first time, then a fraction of one."""
        handling = self._handling
        await asyncio.to_thread(
            lambda: opened(handling.held, 0, handling.lift, handling.taps).sense(PERIOD / s)
        )

    async def batches(self, clock: Clock) -> AsyncIterator[Touch]:
        """A sample every 10 ms."""
        handling, origin = self._handling, clock.now()
        grasp = handling.begin(origin)
        for number in count() if handling.seconds is None else range(round(handling.seconds * s / PERIOD)):
            await clock.sleep_until(origin + number * PERIOD)
            touch, held = grasp.sense(number * PERIOD / s)
            handling.happened.append(held)
            yield replace(touch, time=touch.time + origin)

    def describe(self) -> Description:
        """Sensor, object and seed."""
        handling = self._handling
        return {
            "sensor": "TakkTile 2x3, simulated",
            "rate_hz": s / PERIOD,
            "object": handling.held.name,
            "seed": handling.seed,
        }


class Hand(Sink[Commands]):
    """The hand; made by `Handling`."""

    def __init__(self, handling: Handling) -> None:
        self._handling = handling

    @property
    def destination(self) -> str:
        """One flow commands it once."""
        return f"hand around a {self._handling.held.name} {id(self._handling):x}"

    async def open(self, run: Run) -> None:
        """Nothing need be done."""
        del run

    async def write(self, batch: Commands) -> None:
        """Obey from the commands' own time on."""
        self._handling.command(batch)


def opened(held: Object, seed: int, lift: Lift, taps: Sequence[Tap] = ()) -> "Grasp":
    """A hand that is open until it is commanded."""
    from connectors.sim.grasp import Grasp  # noqa: PLC0415 - loads numba: only to run

    return Grasp(held, seed=seed, force=0.0, closing=0.0, lift=lift, taps=taps)


def press(grasp: "Grasp", commands: Commands, origin: int) -> None:
    """Command a grasp that began at `origin` (ns); a NaN force changes nothing."""
    for time, force in zip(commands.time.tolist(), commands.force.tolist(), strict=True):
        if not math.isnan(force):
            grasp.press(max(force, 0.0), (time - origin) / s)
