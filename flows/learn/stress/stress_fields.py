"""How far each stress field is taken, what is hoped for there, and where a score breaks."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType
from typing import Final

from connectors.sim.paper_plan import PaperPlan as Plan

FALL: Final = 10.0  # points of balanced accuracy below nominal: broken


@dataclass(frozen=True, slots=True)
class Grid:
    """The values of one field, and how they are shown to a person.

    >>> GRIDS["slip_speed"].show(0.2), GRIDS["noise"].show(14.0)
    ('10 mm/s', '14 counts')
    """

    values: tuple[float, ...]  # nominal first, then ever harder; a second side follows the first
    text: str  # what the panel is called
    unit: str = ""  # of what is shown
    scale: float = 1.0  # shown per value

    def number(self, value: float) -> str:
        """A value without its unit."""
        return f"{value * self.scale:.3g}"

    def show(self, value: float) -> str:
        """A value as a person reads it."""
        return f"{self.number(value)} {self.unit}".rstrip()

    @property
    def sides(self) -> dict[str, tuple[float, ...]]:
        """The values from nominal outwards, on each side of it that there is."""
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
    """The plan that a field is applied to: as it is, but for slip speed all strokes at 50 mm/s, no rotation.

    So a factor of slip speed is one speed, and what the arm's speed labels slip are strokes at that speed.
    """
    if field != "slip_speed":
        return plan
    return replace(plan, speeds=(0.05,) * len(plan.speeds), rotations=0)


@dataclass(frozen=True, slots=True)
class Goal:
    """The balanced accuracy that the default detector is to reach under one stress."""

    text: str
    field: str
    value: float
    least: float  # %


GOALS: Final = (
    Goal("slip at 10 mm/s", "slip_speed", 0.2, 85),
    Goal("slip at 5 mm/s", "slip_speed", 0.1, 70),
    Goal("noise of 14 counts", "noise", 14, 88),
    Goal("no stick-slip", "stick_slip", 0, 88),
    Goal("low friction, x 0.3", "friction", 0.3, 87),
    Goal("one dead barometer", "dead", 1, 92),
    Goal("two dead barometers", "dead", 2, 88),
)


def breaking_point(values: Sequence[float], scores: Sequence[float], fall: float = FALL) -> float | None:
    """The value at which the score lies `fall` below the first one.

    Args:
        values: from nominal outwards.
        scores: at each value; NaN where there is none, which is broken.
        fall: in the scores' unit.

    Returns:
        Interpolated between the last value that holds and the first that does not; None where all hold.

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
