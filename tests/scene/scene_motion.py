"""The motion effects of the real data, as the paper's Table III shows them."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from flows.learn.evaluation.motion_metrics import Cell, Chosen
from flows.learn.evaluation.published import SPEEDS


@dataclass(frozen=True, slots=True)
class Effect:
    """What the paper's Table III shows: one group is recognised better or worse than another."""

    text: str
    first: Chosen
    second: Chosen
    paper: float  # points of F1, from means over the cells of the table

    def verdict(self, gap: float, error: float) -> str:
        """Whether a gap with a standard error shows the same."""
        if np.isnan(gap):
            return "not in the plan"
        if abs(gap) < 2 * error:
            return "no clear effect"
        return "reproduced" if (gap > 0) == (self.paper > 0) else "reversed"


def _slides(cell: Cell) -> bool:
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
    Effect("rotation, against translation", lambda c: not _slides(c), _slides, -10.6),
    Effect("10 cm/s, against 5 cm/s", lambda c: c.speed == SPEEDS[2], lambda c: c.speed == SPEEDS[0], 2.9),
    Effect(
        "cylinder y, primary, at 5 cm/s, against it faster",
        lambda c: (c.surface, c.kind, c.speed) == ("cylinder_y", "primary", SPEEDS[0]),
        lambda c: (c.surface, c.kind) == ("cylinder_y", "primary") and c.speed != SPEEDS[0],
        -10.2,
    ),
)
