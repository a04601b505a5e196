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
from typing import Any, Final, TypeAlias

import numpy as np

from connectors.sim.scene import Move, Plan, Scene, Vibration
from operators.batch import BAROMETERS
from operators.checks import check_choice
from operators.errors import ParameterError

Change: TypeAlias = Callable[[Scene, float], Scene]
Join: TypeAlias = Callable[[float, float], float]


@dataclass(frozen=True, slots=True)
class StressField:
    """One quantity that makes a scene harder."""

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


def _changed(scene: Scene, part: str, **values: Any) -> Scene:  # noqa: ANN401 - as `replace`
    changes: dict[str, Any] = {part: replace(getattr(scene, part), **values)}
    return replace(scene, **changes)


def _friction(scene: Scene, value: float) -> Scene:
    p = scene.parameters
    static, kinetic = value * p.static_friction, value * p.kinetic_friction
    return _changed(scene, "parameters", static_friction=static, kinetic_friction=kinetic)


def _stick_slip(scene: Scene, value: float) -> Scene:
    p = scene.parameters
    static = value * p.static_friction + (1 - value) * p.kinetic_friction  # exact at 1
    return _changed(scene, "parameters", static_friction=static)


def _vibration(scene: Scene, value: float) -> Scene:
    vibration = scene.vibration or Vibration(0.0)
    return replace(scene, vibration=replace(vibration, amplitude=vibration.amplitude + value))


def _joined(part: str, name: str, join: Join) -> Change:
    def change(scene: Scene, value: float) -> Scene:
        before: float = getattr(getattr(scene, part), name)
        return _changed(scene, part, **{name: join(before, value)})

    return change


def _every_cell(fault: str, join: Join, neutral: float) -> Change:
    def change(scene: Scene, value: float) -> Scene:
        before: tuple[float, ...] = getattr(scene.faults, fault) or (neutral,) * BAROMETERS
        return _changed(scene, "faults", **{fault: tuple(join(x, value) for x in before)})

    return change


def _first_cells(fault: str) -> Change:
    def change(scene: Scene, value: float) -> Scene:
        if value not in range(BAROMETERS + 1):
            raise ParameterError("stressed", fault, value, f"a number of cells, 0 to {BAROMETERS}")
        cells: set[int] = {*getattr(scene.faults, fault), *range(int(value))}
        return _changed(scene, "faults", **{fault: tuple(sorted(cells))})

    return change


def _either(a: float, b: float) -> float:
    return 1 - (1 - a) * (1 - b)


def _stream(stream: str) -> dict[str, StressField]:
    return {
        f"{stream}_jitter": StressField(0, _joined(stream, "jitter", math.hypot)),
        f"{stream}_dropped": StressField(0, _joined(stream, "dropped", _either)),
        f"{stream}_clock_offset": StressField(0, _joined(stream, "offset", operator.add)),
        f"{stream}_clock_rate": StressField(0, _joined(stream, "drift", operator.add)),
    }


FIELDS: Final[Mapping[str, StressField]] = MappingProxyType(
    {
        # barometers
        "noise": StressField(0, _joined("parameters", "noise", math.hypot)),  # standard deviation
        "gain": StressField(1, _every_cell("gain", operator.mul, 1.0)),
        "offset": StressField(0, _every_cell("offset", operator.add, 0.0)),
        "drift": StressField(0, _every_cell("drift", operator.add, 0.0)),
        "dead": StressField(0, _first_cells("dead")),
        "stuck": StressField(0, _first_cells("stuck")),
        "floored": StressField(0, _first_cells("floored")),
        # streams: standard deviation of stamps, fraction of lost samples, clock offset and clock rate error
        **_stream("touch"),
        **_stream("motion"),
        # contact and plan
        "vibration": StressField(0, _vibration),
        "friction": StressField(1, _friction),
        "stick_slip": StressField(1, _stick_slip),  # excess of static over kinetic friction
        "force": StressField(1, lambda scene, x: replace(scene, plan=Scaled(scene.plan, x))),
        "slip_speed": StressField(1, lambda scene, x: replace(scene, plan=Scaled(scene.plan, 1.0, x))),
    }
)
