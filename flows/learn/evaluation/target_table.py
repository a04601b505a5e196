"""Columns of a table that compare a detector with each target: the arm-speed label and true sliding."""

from collections.abc import Iterable, Mapping
from math import isnan
from typing import Final

from flows.learn.evaluation.event_metrics import Performance
from flows.learn.labelled_recordings import TARGETS, Target

# name of the column; field of `Performance`
_MEASURES: Final[Mapping[str, str]] = {
    "balanced %": "balanced",
    "false/min": "false_alarms_per_min",
    "missed %": "missed",
    "delay ms": "onset_ms",
}
_LEAD: Final = "lead ms"
TITLES: Final[Mapping[Target, str]] = {"arm-speed": "arm speed", "sliding": "sliding"}
TARGET_DECIMALS: Final[Mapping[str, int | None]] = {
    _LEAD: 0,
    **{f"{TITLES[target]}: delay ms": 0 for target in TARGETS},
}


def target_head(targets: Iterable[Target]) -> list[str]:
    """Return the names of the columns for these targets."""
    return [*(f"{TITLES[target]}: {measure}" for target in targets for measure in _MEASURES), _LEAD]


def target_cells(found: Mapping[Target, Performance]) -> list[float]:
    """Return the cells of a detector's performance against each target."""
    cells = [float(getattr(each, name)) for each in found.values() for name in _MEASURES.values()]
    return [*cells, found["arm-speed"].lead_ms]


def lead_text(found: Performance) -> str:
    """Return when slips are reported, relative to the arm-speed label.

    >>> lead_text(Performance(90.0, 90.0, 1.0, 2.0, 30.0, lead_ms=-20.0))
    '20 ms after'
    """
    if isnan(found.lead_ms):
        return "at no known time before or after"
    return f"{abs(found.lead_ms):.0f} ms {'before' if found.lead_ms >= 0 else 'after'}"
