"""What can be made harder in any scene: one field, one value at a time.

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
from operators.errors import ParameterError

Part: TypeAlias = Literal["touch", "motion", "truth"]
Stream: TypeAlias = Literal["touch", "motion"]
Change: TypeAlias = Callable[[Scene, float], Scene]
Join: TypeAlias = Callable[[float, float], float]


@dataclass(frozen=True, slots=True)
class Field:
    """One way to make a scene harder."""

    unit: str  # "1": a factor or a share
    nominal: float  # the value that changes nothing
    shows: tuple[Part, ...]  # where a recording shows it; the rest stays as it is, byte for byte
    change: Change


@dataclass(frozen=True, slots=True)
class Scaled:
    """A plan with all its normal forces and all its speeds multiplied."""

    plan: Plan
    force: float = 1.0
    speed: float = 1.0

    def moves(self, random: np.random.Generator) -> Iterator[Move]:
        """The plan's moves, as long and in the same directions."""
        for move in self.plan.moves(random):
            force = None if move.force is None else move.force * self.force
            yield replace(move, force=force, speed=move.speed * self.speed)


def stressed(scene: Scene, field: str, value: float) -> Scene:
    """The scene with one of `FIELDS` at a value, which comes on top of what the scene itself says.

    Raises:
        ParameterError: if there is no such field, or it cannot have that value.
    """
    if field not in FIELDS:
        raise ParameterError("stressed", "field", field, f"one of {', '.join(FIELDS)}")
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
    static = value * p.static_friction + (1 - value) * p.kinetic_friction  # at 1 exactly what it was
    return replace(scene, parameters=replace(p, static_friction=static))


def _vibration(scene: Scene, value: float) -> Scene:
    shaking = scene.vibration or Vibration(0.0)
    return replace(scene, vibration=replace(shaking, amplitude=shaking.amplitude + value))


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


def _stream(stream: Stream) -> dict[str, Field]:
    return {
        f"{stream}_jitter": Field("s", 0, (stream,), _timing(stream, "jitter", math.hypot)),
        f"{stream}_dropped": Field("1", 0, (stream,), _timing(stream, "dropped", _either)),
        f"{stream}_clock_offset": Field("s", 0, (stream,), _timing(stream, "offset", operator.add)),
        f"{stream}_clock_rate": Field("s/s", 0, (stream,), _timing(stream, "drift", operator.add)),
    }


FIELDS: Final[Mapping[str, Field]] = MappingProxyType(
    {
        # the barometers
        "noise": Field("count", 0, ("touch",), _noise),  # standard deviation
        "gain": Field("1", 1, ("touch",), _every_cell("gain", operator.mul, 1.0)),
        "offset": Field("count", 0, ("touch",), _every_cell("offset", operator.add, 0.0)),
        "drift": Field("count/s", 0, ("touch",), _every_cell("drift", operator.add, 0.0)),
        "dead": Field("cells", 0, ("touch",), _first_cells("dead")),
        "stuck": Field("cells", 0, ("touch",), _first_cells("stuck")),
        "floored": Field("cells", 0, ("touch",), _first_cells("floored")),
        # the streams: standard deviation of stamps, share lost, error of the clock and of its rate
        **_stream("touch"),
        **_stream("motion"),
        # the world; force and speed are the plan's
        "vibration": Field("m", 0, ("touch", "truth"), _vibration),
        "friction": Field("1", 1, ("touch", "truth"), _friction),
        "stick_slip": Field(
            "1", 1, ("touch", "truth"), _stick_slip
        ),  # excess of static over kinetic friction
        "force": Field(
            "1", 1, ("touch", "truth"), lambda scene, x: replace(scene, plan=Scaled(scene.plan, x))
        ),
        "slip_speed": Field(
            "1",
            1,
            ("touch", "motion", "truth"),
            lambda scene, x: replace(scene, plan=Scaled(scene.plan, 1.0, x)),
        ),
    }
)
