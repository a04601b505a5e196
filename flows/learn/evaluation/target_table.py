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
BY_HAND: Final[Mapping[Target, str]] = {**TITLES, "arm-speed": "arm and hand"}  # with labels by hand
TARGET_DECIMALS: Final[Mapping[str, int | None]] = {
    _LEAD: 0,
    **{f"{titles[target]}: delay ms": 0 for titles in (TITLES, BY_HAND) for target in TARGETS},
}


def target_head(targets: Iterable[Target], titles: Mapping[Target, str] = TITLES) -> list[str]:
    """Return the names of the columns for these targets."""
    return [*(f"{titles[target]}: {measure}" for target in targets for measure in _MEASURES), _LEAD]


def target_cells(found: Mapping[Target, Performance]) -> list[float]:
    """Return the cells of a detector's performance against each target."""
    cells = [float(getattr(each, name)) for each in found.values() for name in _MEASURES.values()]
    return [*cells, found["arm-speed"].lead_ms]


def event_text(alarms: float, missed: float, delay: float) -> str:
    """Return the end of a sentence about a detector's events.

    Args:
        alarms: False alarms per static minute; NaN: nothing is static.
        missed: Missed slips, %; NaN: there are no slips.
        delay: Median delay, ms; NaN: no slip is detected.

    >>> event_text(1.04, 2.0, 31.0)
    'raises 1.0 false alarms per static minute, misses 2.0 % of slips, and is 31 ms late (median)'
    >>> event_text(float("nan"), 2.0, -31.0)
    'misses 2.0 % of slips, and is 31 ms early (median); nothing is static'
    """
    known = [
        (alarms, f"raises {alarms:.1f} false alarms per static minute"),
        (missed, f"misses {missed:.1f} % of slips"),
        (delay, f"is {abs(delay):.0f} ms {'early' if delay < 0 else 'late'} (median)"),
    ]
    *first, last = [text for value, text in known if not isnan(value)] or ["has no events to judge"]
    lacking = [
        *(["nothing is static"] if isnan(alarms) else []),
        *(["there are no slips"] if isnan(missed) else []),
    ]
    return "; ".join([", and ".join([", ".join(first), last] if first else [last]), *lacking])


def lead_text(found: Performance) -> str:
    """Return when slips are reported, relative to the label.

    >>> lead_text(Performance(90.0, 90.0, 1.0, 2.0, 30.0, lead_ms=-20.0))
    '20 ms after'
    """
    if isnan(found.lead_ms):
        return "at no known time before or after"
    return f"{abs(found.lead_ms):.0f} ms {'before' if found.lead_ms >= 0 else 'after'}"
