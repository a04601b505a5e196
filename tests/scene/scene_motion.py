"""Effects of the motion on detection in the real data, from the paper's Table III."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from flows.learn.evaluation.motion_metrics import MotionConfusions, MotionGroup, MotionKind
from flows.learn.evaluation.published import SPEEDS, SURFACES, TABLE_1, TABLE_3, TABLE_3_ANY
from flows.learn.evaluation.sample_metrics import Confusion
from operators.batch import Reals


@dataclass(frozen=True, slots=True)
class Effect:
    """A difference between two groups of motions in the paper's Table III."""

    text: str
    first: MotionGroup
    second: MotionGroup
    paper: float  # points of F1, from means over the cells of the table

    def verdict(self, difference: float, error: float) -> str:
        """Compare a difference and its standard error with the paper's."""
        if np.isnan(difference):
            return "not in the plan"
        if abs(difference) < 2 * error:
            return "no clear effect"
        return "reproduced" if (difference > 0) == (self.paper > 0) else "reversed"


def f1_difference(
    found: MotionConfusions, first: MotionGroup, second: MotionGroup, seed: int = 0, draws: int = 300
) -> tuple[float, float]:
    """Return F1 of the first group less that of the second, and its standard error; NaN if one is empty.

    The error is that of a bootstrap over recordings.
    """
    sides = [
        found.counts * np.array([group(cell) for cell in found.kinds])[:, None, None]
        for group in (first, second)
    ]
    number = int(found.recordings[-1]) + 1
    random = np.random.default_rng(seed)

    def difference(weights: Reals) -> float:  # (recordings,)
        one, other = (Confusion((side * weights[found.recordings, None, None]).sum(axis=0)) for side in sides)
        return one.f1 - other.f1

    whole = difference(np.ones(number))
    if np.isnan(whole):
        return whole, whole
    shares = np.full(number, 1 / number)
    drawn = [difference(np.asarray(random.multinomial(number, shares), np.float64)) for _ in range(draws)]
    return whole, float(np.nanstd(drawn))


def _translation(cell: MotionKind) -> bool:
    return cell.kind != "rotation"


EFFECTS: Final = (
    Effect(
        "plane, against the other surfaces",
        lambda c: c.surface == "plane",
        lambda c: c.surface != "plane",
        4.4,
    ),
    Effect(
        "sphere, against the other surfaces",
        lambda c: c.surface == "sphere",
        lambda c: c.surface != "sphere",
        -2.4,
    ),
    Effect(
        "oblique strokes, against primary", lambda c: c.kind == "oblique", lambda c: c.kind == "primary", 1.3
    ),
    Effect("rotation, against translation", lambda c: not _translation(c), _translation, -10.6),
    Effect("10 cm/s, against 5 cm/s", lambda c: c.speed == SPEEDS[2], lambda c: c.speed == SPEEDS[0], 2.9),
    Effect(
        "cylinder y, primary, 5 cm/s, against faster",
        lambda c: (c.surface, c.kind, c.speed) == ("cylinder_y", "primary", SPEEDS[0]),
        lambda c: (c.surface, c.kind) == ("cylinder_y", "primary") and c.speed != SPEEDS[0],
        -10.2,
    ),
)


def groups() -> list[tuple[str, MotionGroup, float]]:
    """Return the groups of windows that the paper has figures for: name, cells, F1 (%)."""

    def on(surface: str) -> MotionGroup:
        return lambda cell: cell.surface == surface

    def moved(kind: str, pace: float | None) -> MotionGroup:
        return lambda cell: (cell.kind, cell.speed) == (kind, pace)

    surfaces = [(spaced(s), on(s), f1) for s, f1 in zip(SURFACES, TABLE_3_ANY, strict=True)]
    motions = [(motion_name(*motion), moved(*motion), f1[-1]) for motion, f1 in TABLE_3.items()]
    return [("all", lambda _: True, TABLE_1["TCN"][-1]), *surfaces, *motions]


def spaced(name: str) -> str:
    """Return a name with spaces."""
    return name.replace("_", " ")


def motion_name(kind: str, pace: float | None) -> str:
    """Return kind and speed of a motion as text."""
    return f"{kind}, 1 rad/s" if pace is None else f"{kind}, {100 * pace:g} cm/s"
