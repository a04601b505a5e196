"""Columns of a table that give the figures of a method with their intervals over recordings."""

from typing import Final

from flows.learn.evaluation.intervals import Estimate, Figures
from flows.report.table import Value

_HEADS: Final = (  # field of `Figures`; name of the column; decimals
    ("balanced", "balanced %", 1),
    ("far", "far %", 1),
    ("area", "AUC %", 1),
    ("events_per_min", "events/min", 1),
    ("false_alarms_per_min", "false/min", 1),
    ("missed", "missed %", 1),
    ("delay", "delay ms", 0),
)
FIGURES_HEAD: Final = tuple(name for _, head, _ in _HEADS for name in (head, f"{head} 95 %"))
FIGURES_DECIMALS: Final = {head: decimals for _, head, decimals in _HEADS}


def figures_cells(figures: Figures) -> list[Value]:
    """Return the cells of a method: each figure and its interval."""
    cells: list[Value] = []
    for name, _, decimals in _HEADS:
        estimate: Estimate = getattr(figures, name)
        cells += [estimate.value, estimate.interval(decimals) or None]
    return cells
