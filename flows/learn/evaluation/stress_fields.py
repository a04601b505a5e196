"""Stress fields: what each changes in a scene, and its values.

>>> stressed(Scene(), "noise", 14.0).parameters.noise
14.0
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final, TypeAlias

import numpy as np

from connectors.sim.paper_plan import PaperPlan
from connectors.sim.scene import Move, Plan, Scene, Vibration
from operators.batch import BAROMETERS

Change: TypeAlias = Callable[[Scene, float], Scene]


@dataclass(frozen=True, slots=True)
class StressField:
    """One quantity that makes a scene harder: its effect, values and display.

    >>> FIELDS["slip_speed"].show(0.2), FIELDS["noise"].show(14.0)
    ('10 mm/s', '14 counts')
    """

    change: Change
    values: tuple[float, ...]  # nominal first, then increasing stress; a second side follows the first
    text: str  # title of the panel
    unit: str = ""  # of the displayed value
    scale: float = 1.0  # factor from value to displayed value

    def number(self, value: float) -> str:
        """Return a value as text, without its unit."""
        return f"{value * self.scale:.3g}"

    def show(self, value: float) -> str:
        """Return a value as text with its unit."""
        return f"{self.number(value)} {self.unit}".rstrip()

    @property
    def nominal(self) -> float:
        """Value without effect."""
        return self.values[0]


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
    """Return a scene under one of the stresses `FIELDS`."""
    return scene if value == FIELDS[field].nominal else FIELDS[field].change(scene, value)


def _changed(scene: Scene, part: str, **values: Any) -> Scene:
    changes: dict[str, Any] = {part: replace(getattr(scene, part), **values)}
    return replace(scene, **changes)


def _value(part: str, name: str) -> Change:
    return lambda scene, value: _changed(scene, part, **{name: value})


def _every_cell(fault: str) -> Change:
    return lambda scene, value: _changed(scene, "faults", **{fault: (value,) * BAROMETERS})


def _first_cells(fault: str) -> Change:
    return lambda scene, value: _changed(scene, "faults", **{fault: tuple(range(int(value)))})


def _friction(scene: Scene, value: float) -> Scene:
    p = scene.parameters
    static, kinetic = value * p.static_friction, value * p.kinetic_friction
    return _changed(scene, "parameters", static_friction=static, kinetic_friction=kinetic)


def _stick_slip(scene: Scene, value: float) -> Scene:
    p = scene.parameters
    static = value * p.static_friction + (1 - value) * p.kinetic_friction
    return _changed(scene, "parameters", static_friction=static)


def _vibration(scene: Scene, value: float) -> Scene:
    vibration = scene.vibration or Vibration(0.0)
    return replace(scene, vibration=replace(vibration, amplitude=vibration.amplitude + value))


def _stream(stream: str) -> dict[str, StressField]:
    """Return the fields of a stream: jitter and loss of samples, offset and rate error of its clock."""
    off, fast = f"{stream} clock off", f"{stream} clock fast"
    return {
        f"{stream}_jitter": StressField(
            _value(stream, "jitter"), (0, 0.001, 0.002, 0.005, 0.01), f"{stream} jitter", "ms", 1e3
        ),
        f"{stream}_dropped": StressField(
            _value(stream, "dropped"), (0, 0.05, 0.1, 0.2, 0.4), f"{stream} lost", "%", 100
        ),
        f"{stream}_clock_offset": StressField(
            _value(stream, "offset"), (0, 0.05, 0.1, -0.05, -0.1), off, "ms", 1e3
        ),
        f"{stream}_clock_rate": StressField(
            _value(stream, "drift"), (0, 1e-3, 3e-3, 1e-2), fast, "ms/s", 1e3
        ),
    }


FIELDS: Final[Mapping[str, StressField]] = MappingProxyType(
    {
        "noise": StressField(_value("parameters", "noise"), (0.6, 3.5, 7, 14, 28), "noise", "counts"),
        "gain": StressField(_every_cell("gain"), (1, 1.5, 2.5, 0.5, 0.25, 0.1), "gain"),
        "offset": StressField(_every_cell("offset"), (0, 200, 400, -200, -400), "offset", "counts"),
        "drift": StressField(_every_cell("drift"), (0, 2, 6, 20, -2, -6, -20), "drift", "counts/s"),
        "dead": StressField(_first_cells("dead"), (0, 1, 2, 3, 4), "dead cells"),
        "stuck": StressField(_first_cells("stuck"), (0, 1, 2, 3, 4), "stuck cells"),
        "floored": StressField(_first_cells("floored"), (0, 1, 2, 3, 4), "floored cells"),
        **_stream("touch"),
        **_stream("motion"),
        "vibration": StressField(_vibration, (0, 1.5e-4, 3e-4, 4.5e-4, 9e-4), "more vibration", "mm", 1e3),
        "friction": StressField(_friction, (1, 0.7, 0.5, 0.3, 0.15), "friction", "x"),
        "stick_slip": StressField(_stick_slip, (1, 0.75, 0.5, 0.25, 0), "stick-slip", "x"),
        "force": StressField(
            lambda scene, x: replace(scene, plan=Scaled(scene.plan, x)),
            (1, 2, 4, 0.5, 0.25, 0.1),
            "grip force",
            "x",
        ),
        "slip_speed": StressField(
            lambda scene, x: replace(scene, plan=Scaled(scene.plan, 1.0, x)),
            (1, 0.6, 0.4, 0.2, 0.08),
            "slip speed",
            "mm/s",
            50,
        ),
    }
)


def plan_of(field: str, plan: PaperPlan) -> PaperPlan:
    """Return the plan that a field is applied to; for slip speed, all strokes at 50 mm/s and no rotation.

    So each factor of slip speed corresponds to one speed of all strokes.
    """
    if field != "slip_speed":
        return plan
    return replace(plan, speeds=(0.05,) * len(plan.speeds), rotations=0)
