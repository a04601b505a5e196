"""Values of each stress field, goals, and the breaking point of a score."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType
from typing import Final

from connectors.sim.paper_plan import PaperPlan as Plan

FALL: Final = 10.0  # percentage points below nominal balanced accuracy: broken


@dataclass(frozen=True, slots=True)
class Grid:
    """Values of one field and their display.

    >>> GRIDS["slip_speed"].show(0.2), GRIDS["noise"].show(14.0)
    ('10 mm/s', '14 counts')
    """

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
    def sides(self) -> dict[str, tuple[float, ...]]:
        """Values from nominal outwards, on each existing side."""
        nominal = self.values[0]
        up = tuple(value for value in self.values if value > nominal)
        down = tuple(value for value in self.values if value < nominal)
        return {name: (nominal, *side) for name, side in (("up", up), ("down", down)) if side}


GRIDS: Final[Mapping[str, Grid]] = MappingProxyType(
    {
        "noise": Grid((0, 3.5, 7, 14, 28), "noise", "counts"),
        "gain": Grid((1, 1.5, 2.5, 0.5, 0.25, 0.1), "gain"),
        "offset": Grid((0, 200, 400, -200, -400), "offset", "counts"),
        "drift": Grid((0, 2, 6, 20, -2, -6, -20), "drift", "counts/s"),
        "dead": Grid((0, 1, 2, 3, 4), "dead cells"),
        "stuck": Grid((0, 1, 2, 3, 4), "stuck cells"),
        "floored": Grid((0, 1, 2, 3, 4), "floored cells"),
        "touch_jitter": Grid((0, 0.001, 0.002, 0.005, 0.01), "touch jitter", "ms", 1e3),
        "touch_dropped": Grid((0, 0.05, 0.1, 0.2, 0.4), "touch lost", "%", 100),
        "touch_clock_offset": Grid((0, 0.05, 0.1, -0.05, -0.1), "touch clock off", "ms", 1e3),
        "touch_clock_rate": Grid((0, 1e-3, 3e-3, 1e-2), "touch clock fast", "ms/s", 1e3),
        "motion_jitter": Grid((0, 0.001, 0.002, 0.005, 0.01), "motion jitter", "ms", 1e3),
        "motion_dropped": Grid((0, 0.05, 0.1, 0.2, 0.4), "motion lost", "%", 100),
        "motion_clock_offset": Grid((0, 0.05, 0.1, -0.05, -0.1), "motion clock off", "ms", 1e3),
        "motion_clock_rate": Grid((0, 1e-3, 3e-3, 1e-2), "motion clock fast", "ms/s", 1e3),
        "vibration": Grid((0, 1.5e-4, 3e-4, 4.5e-4, 9e-4), "more vibration", "mm", 1e3),
        "friction": Grid((1, 0.7, 0.5, 0.3, 0.15), "friction", "x"),
        "stick_slip": Grid((1, 0.75, 0.5, 0.25, 0), "stick-slip", "x"),
        "force": Grid((1, 2, 4, 0.5, 0.25, 0.1), "grip force", "x"),
        "slip_speed": Grid((1, 0.6, 0.4, 0.2, 0.1), "slip speed", "mm/s", 50),
    }
)


def plan_of(field: str, plan: Plan) -> Plan:
    """Return the plan that a field is applied to; for slip speed, all strokes at 50 mm/s and no rotation.

    So each factor of slip speed corresponds to one speed of all strokes.
    """
    if field != "slip_speed":
        return plan
    return replace(plan, speeds=(0.05,) * len(plan.speeds), rotations=0)


@dataclass(frozen=True, slots=True)
class StressGoal:
    """Balanced accuracy that the default detector should reach under one stress."""

    text: str
    field: str
    value: float
    least: float  # %


GOALS: Final = (
    StressGoal("slip at 10 mm/s", "slip_speed", 0.2, 85),
    StressGoal("slip at 5 mm/s", "slip_speed", 0.1, 70),
    StressGoal("noise of 14 counts", "noise", 14, 88),
    StressGoal("no stick-slip", "stick_slip", 0, 88),
    StressGoal("low friction, x 0.3", "friction", 0.3, 87),
    StressGoal("one dead barometer", "dead", 1, 92),
    StressGoal("two dead barometers", "dead", 2, 88),
)


def breaking_point(values: Sequence[float], scores: Sequence[float], fall: float = FALL) -> float | None:
    """Return the value at which the score lies `fall` below the first one.

    Args:
        values: Values of the field, from nominal outwards.
        scores: Score at each value; NaN counts as broken.
        fall: Fall of the score, in its unit.

    Returns:
        Value interpolated between the last above the limit and the first below; None if all are above.

    >>> breaking_point([0, 1, 2], [90, 85, 75])
    1.5
    """
    least = scores[0] - fall
    for (held, above), (value, score) in pairwise(zip(values, scores, strict=True)):
        if math.isnan(score):
            return value
        if score <= least:
            return held + (value - held) * (above - least) / (above - score)
    return None
