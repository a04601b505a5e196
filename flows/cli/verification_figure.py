"""Figure of a verification: readable and unreadable rows of each session over time."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from flows.report.figures import INK, MAIN, SECOND, Figure, grid, styled
from operators.batch import s
from storage.verification import Checked, Verified, severity

MAX_SESSIONS: Final = 40

_BINS: Final = 400  # in the longest session
_HEIGHT: Final = 0.8  # of a lane, for the highest rate


@styled
def session_lanes(found: Verified) -> Figure:
    """Draw a lane with the row rate of each session; at least one file must have rows."""
    dated = {name: [each for each in parts if each.part.rows] for name, parts in by_session(found).items()}
    parts = {name: dated[name] for name in worst_sessions(found) if dated[name]}
    width = max(max(_span(each) for each in parts.values()) / s / _BINS, 1e-3)  # s
    counts = {name: count_rows(each, width) for name, each in parts.items()}
    top = max(float(readable.max() + lost.max()) for readable, lost in counts.values()) or 1.0
    figure, [axis] = grid(1, 1, (10.0, 1.1 + 0.42 * len(parts)))
    for lane, (readable, lost) in enumerate(counts.values()):
        edges = np.arange(len(readable) + 1) * width
        for low, high, colour in ((0 * readable, readable, MAIN), (readable, readable + lost, SECOND)):
            if not (high > low).any():
                continue
            top_edge = lane + 0.4 - _HEIGHT * np.append(high, high[-1]) / top
            base = lane + 0.4 - _HEIGHT * np.append(low, low[-1]) / top
            axis.fill_between(edges, base, top_edge, step="post", color=colour, linewidth=0)
    axis.set_yticks(range(len(parts)), [name.replace("$", r"\$") for name in parts])
    axis.set_ylim(len(parts) - 0.5, -0.5)
    axis.set_xlim(0, None)
    axis.set_xlabel(f"s since the session's first row; full height: {top / width:,.0f} rows/s", color=INK)
    return figure


def by_session(found: Verified) -> dict[str, list[Checked]]:
    """Return the files of each session."""
    parts: dict[str, list[Checked]] = {name: [] for name in found.names}
    for each in found.parts:
        parts[each.session].append(each)
    return parts


def worst_sessions(found: Verified) -> Sequence[str]:
    """Return the sessions to draw, in order: all, or those with the most severe findings."""
    worst = {name: severity("note") for name in found.names}
    for finding in found.findings:
        if finding.session in worst:
            worst[finding.session] = max(worst[finding.session], severity(finding.weight))
    kept = set(sorted(found.names, key=lambda name: -worst[name])[:MAX_SESSIONS])
    return [name for name in found.names if name in kept]


def count_rows(parts: Sequence[Checked], width: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return readable and unreadable rows, (n,) each, in bins of `width` s; a file's rows spread evenly."""
    origin = min(each.part.first for each in parts)
    bins = int(_span(parts) / s / width) + 1
    counts = np.zeros((2, bins))
    for each in parts:
        first, last = (each.part.first - origin) / s / width, (each.part.last - origin) / s / width
        share = np.diff(np.clip(np.arange(bins + 1), first, max(last, first + 1e-9)))
        counts[0 if each.whole else 1] += each.part.rows * share / share.sum()
    return counts[0], counts[1]


def _span(parts: Sequence[Checked]) -> int:
    """Return the time from the first to the last row, ns."""
    return max(each.part.last for each in parts) - min(each.part.first for each in parts)
