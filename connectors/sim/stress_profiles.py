"""Stress fields: quantities that make a scene harder, applied one at a time.

>>> harder = stressed(Scene(), "noise", 14.0)
>>> harder.parameters.noise, stressed(Scene(), "noise", 0.0) == Scene()
(14.0, True)
"""

import math
import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from connectors.sim.scene import Move, Plan, Scene, Vibration
from operators.batch import BAROMETERS
from operators.checks import check_choice
from operators.errors import ParameterError

Stream: TypeAlias = Literal["touch", "motion"]
Change: TypeAlias = Callable[[Scene, float], Scene]
Join: TypeAlias = Callable[[float, float], float]


@dataclass(frozen=True, slots=True)
class StressField:
    """One quantity that makes a scene harder."""

    unit: str  # "1" for a factor or a fraction
    nominal: float  # value without effect
    change: Change


@dataclass(frozen=True, slots=True)
class Scaled:
    """A plan with all normal forces and all speeds multiplied."""

    plan: Plan
    force: float = 1.0
    speed: float = 1.0

    def moves(self, random: np.random.Generator) -> Iterator[Move]:
        """Yield the moves of the plan, with the same durations and directions."""
        for move in self.plan.moves(random):
            force = None if move.force is None else move.force * self.force
            yield replace(move, force=force, speed=move.speed * self.speed)


def stressed(scene: Scene, field: str, value: float) -> Scene:
    """Return a scene with the stress of one of `FIELDS` added to its own values.

    Raises:
        ParameterError: if the field is unknown, or the value is out of range.
    """
    check_choice("stressed", "field", field, FIELDS)
    return scene if value == FIELDS[field].nominal else FIELDS[field].change(scene, value)


def _noise(scene: Scene, value: float) -> Scene:
    noise = math.hypot(scene.parameters.noise, value)
    return replace(scene, parameters=replace(scene.parameters, noise=noise))


def _friction(scene: Scene, value: float) -> Scene:
    p = scene.parameters
    scaled = replace(
        p, static_friction=value * p.static_friction, kinetic_friction=value * p.kinetic_friction
    )
    return replace(scene, parameters=scaled)


def _stick_slip(scene: Scene, value: float) -> Scene:
    p = scene.parameters
    static = value * p.static_friction + (1 - value) * p.kinetic_friction  # exact at 1
    return replace(scene, parameters=replace(p, static_friction=static))


def _vibration(scene: Scene, value: float) -> Scene:
    vibration = scene.vibration or Vibration(0.0)
    return replace(scene, vibration=replace(vibration, amplitude=vibration.amplitude + value))


def _every_cell(fault: Literal["gain", "offset", "drift"], join: Join, neutral: float) -> Change:
    def change(scene: Scene, value: float) -> Scene:
        before: tuple[float, ...] = getattr(scene.faults, fault) or (neutral,) * BAROMETERS
        changed: dict[str, Any] = {fault: tuple(join(x, value) for x in before)}
        return replace(scene, faults=replace(scene.faults, **changed))

    return change


def _first_cells(fault: Literal["dead", "stuck", "floored"]) -> Change:
    def change(scene: Scene, value: float) -> Scene:
        if value not in range(BAROMETERS + 1):
            raise ParameterError("stressed", fault, value, f"a number of cells, 0 to {BAROMETERS}")
        cells: set[int] = {*getattr(scene.faults, fault), *range(int(value))}
        return replace(scene, faults=replace(scene.faults, **{fault: tuple(sorted(cells))}))

    return change


def _timing(stream: Stream, part: Literal["jitter", "dropped", "offset", "drift"], join: Join) -> Change:
    def change(scene: Scene, value: float) -> Scene:
        timing = scene.touch if stream == "touch" else scene.motion
        timing = replace(timing, **{part: join(getattr(timing, part), value)})
        return replace(scene, touch=timing) if stream == "touch" else replace(scene, motion=timing)

    return change


def _either(a: float, b: float) -> float:
    return 1 - (1 - a) * (1 - b)


def _stream(stream: Stream) -> dict[str, StressField]:
    return {
        f"{stream}_jitter": StressField("s", 0, _timing(stream, "jitter", math.hypot)),
        f"{stream}_dropped": StressField("1", 0, _timing(stream, "dropped", _either)),
        f"{stream}_clock_offset": StressField("s", 0, _timing(stream, "offset", operator.add)),
        f"{stream}_clock_rate": StressField("s/s", 0, _timing(stream, "drift", operator.add)),
    }


FIELDS: Final[Mapping[str, StressField]] = MappingProxyType(
    {
        # barometers
        "noise": StressField("count", 0, _noise),  # standard deviation
        "gain": StressField("1", 1, _every_cell("gain", operator.mul, 1.0)),
        "offset": StressField("count", 0, _every_cell("offset", operator.add, 0.0)),
        "drift": StressField("count/s", 0, _every_cell("drift", operator.add, 0.0)),
        "dead": StressField("cells", 0, _first_cells("dead")),
        "stuck": StressField("cells", 0, _first_cells("stuck")),
        "floored": StressField("cells", 0, _first_cells("floored")),
        # streams: standard deviation of stamps, fraction of lost samples, clock offset and clock rate error
        **_stream("touch"),
        **_stream("motion"),
        # contact and plan
        "vibration": StressField("m", 0, _vibration),
        "friction": StressField("1", 1, _friction),
        "stick_slip": StressField("1", 1, _stick_slip),  # excess of static over kinetic friction
        "force": StressField("1", 1, lambda scene, x: replace(scene, plan=Scaled(scene.plan, x))),
        "slip_speed": StressField(
            "1",
            1,
            lambda scene, x: replace(scene, plan=Scaled(scene.plan, 1.0, x)),
        ),
    }
)
