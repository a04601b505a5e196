"""Rows of each session over time: those that can be read, those that cannot."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from flows.report.figures import INK, MAIN, SECOND, Figure, grid, styled
from operators.batch import s
from storage.findings import severity
from storage.verification import Checked, Verified

LANES: Final = 40  # sessions, at most

_BINS: Final = 400  # over the longest session
_HEIGHT: Final = 0.8  # of a lane, that the highest rate fills


@styled
def lanes(found: Verified) -> Figure:
    """A lane for each session; `found` lists one file with rows at least."""
    of = {name: [each for each in listed if each.part.rows] for name, listed in by_session(found).items()}
    parts = {name: of[name] for name in chosen(found) if of[name]}
    width = max(max(_span(listed) for listed in parts.values()) / s / _BINS, 1e-3)  # s
    rates = {name: rows(listed, width) for name, listed in parts.items()}
    top = max(float(read.max() + lost.max()) for read, lost in rates.values()) or 1.0
    figure, [axis] = grid(1, 1, (10.0, 1.1 + 0.42 * len(parts)))
    for lane, (read, lost) in enumerate(rates.values()):
        edges = np.arange(len(read) + 1) * width
        for low, high, colour in ((0 * read, read, MAIN), (read, read + lost, SECOND)):
            if not (high > low).any():
                continue
            top_edge = lane + 0.4 - _HEIGHT * np.append(high, high[-1]) / top
            base = lane + 0.4 - _HEIGHT * np.append(low, low[-1]) / top
            axis.fill_between(edges, base, top_edge, step="post", color=colour, linewidth=0)
    axis.set_yticks(range(len(parts)), [name.replace("$", r"\$") for name in parts])
    axis.set_ylim(len(parts) - 0.5, -0.5)
    axis.set_xlim(0, None)
    axis.set_xlabel(f"s since a session's first row; full height: {top / width:,.0f} rows/s", color=INK)
    return figure


def by_session(found: Verified) -> dict[str, list[Checked]]:
    """The files of each session."""
    parts: dict[str, list[Checked]] = {name: [] for name in found.names}
    for each in found.parts:
        parts[each.session].append(each)
    return parts


def chosen(found: Verified) -> Sequence[str]:
    """The sessions that are drawn: if there are too many, those with most that is wrong; in their order."""
    worst = {name: severity("note") for name in found.names}
    for finding in found.findings:
        if finding.session in worst:
            worst[finding.session] = max(worst[finding.session], severity(finding.weight))
    kept = set(sorted(found.names, key=lambda name: -worst[name])[:LANES])
    return [name for name in found.names if name in kept]


def rows(parts: Sequence[Checked], width: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rows in each bin of `width` s that can be read, and that cannot; (n,) each, a part's spread evenly."""
    origin = min(each.part.first for each in parts)
    bins = int(_span(parts) / s / width) + 1
    found = np.zeros((2, bins))
    for each in parts:
        first, last = (each.part.first - origin) / s / width, (each.part.last - origin) / s / width
        edges = np.clip(np.arange(bins + 1), first, max(last, first + 1e-9))
        share = np.diff(edges)
        found[0 if each.whole else 1] += each.part.rows * share / share.sum()
    return found[0], found[1]


def _span(parts: Sequence[Checked]) -> int:
    """Ns."""
    return max(each.part.last for each in parts) - min(each.part.first for each in parts)
