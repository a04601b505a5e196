"""Figures of the report on the scene."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from flows.learn.labelled_recordings import LabelledRecording
from flows.report.figures import CELLS, FAINT, INK, MAIN, SECOND, SHADE, Axes, Figure, grid, styled
from operators.batch import BAROMETERS, Reals
from tests.scene.scene_ablation import TERMS, Ablation
from tests.scene.scene_speed import Speed
from tests.scene.scene_statistics import FREQUENCIES, RATE, TABLE

MARK: Final = 1100  # simulated s per CPU s of one core at 24 nodes, of a prototype


@styled
def traces(shown: Sequence[tuple[str, LabelledRecording, int]], samples: int = 400) -> Figure:
    """Draw counts, normal force and label of recordings: title, recording, first sample of each."""
    rows = -(-len(shown) // 3)
    figure, axes = grid(2 * rows, 3, (12, 2.9 * rows), sharex=True, heights=[3, 1] * rows)
    for number, (title, trial, first) in enumerate(shown):
        place = 6 * (number // 3) + number % 3
        counts, force = axes[place], axes[place + 3]
        part = slice(first, first + samples)
        t = np.arange(len(trial.slip[part])) / RATE
        for cell in range(BAROMETERS):
            counts.plot(t, trial.counts[part, cell], color=CELLS[cell], linewidth=0.9, label=str(cell))
        counts.set(title=title, ylim=(-520, 220), yticks=(-500, -250, 0, 200))
        force.set(ylim=(0, 6), yticks=(0, 5))
        if trial.force is None:
            force.text(0.5, 0.5, "normal force was not measured", ha="center", va="center", color=FAINT,
                       transform=force.transAxes)  # fmt: skip
        else:
            force.plot(t, trial.force[part], color=INK, linewidth=0.9)
        for panel in (counts, force):
            low, high = panel.get_ylim()
            panel.fill_between(
                t, low, high, where=trial.slip[part].tolist(), color=SHADE, linewidth=0, zorder=0
            )
        if number % 3 == 0:
            counts.set_ylabel("counts")
            force.set_ylabel("force, N")
        if number >= len(shown) - 3:
            force.tick_params(labelbottom=True)
            force.set_xlabel("time, s")
    for place in range(len(shown), 3 * rows):
        axes[6 * (place // 3) + place % 3].set_axis_off()
        axes[6 * (place // 3) + place % 3 + 3].set_axis_off()
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(
        handles,
        names,
        loc="outside upper center",
        ncols=BAROMETERS + 1,
        title="barometer (shaded: labelled slip)",
    )
    return figure


@styled
def realism(rows: Sequence[tuple[str, float, bool]], unit: str) -> Figure:
    """Draw scores of detectors: text, %, and True for a value to compare with."""
    figure, (axis,) = grid(1, 1, (7.5, 0.6 + 0.32 * len(rows)))
    for place, (_, value, mark) in enumerate(reversed(rows)):
        axis.plot([50, value], [place, place], color="#e6e9ed", linewidth=2, zorder=0)
        axis.plot(value, place, "o", color=MAIN, markersize=7, markerfacecolor="white" if mark else MAIN)
        axis.annotate(f"{value:.1f}", (value, place), (8, 0), textcoords="offset points", va="center")
    axis.set(xlim=(50, 100), xlabel=unit, ylim=(-0.6, len(rows) - 0.4))
    axis.set_yticks(range(len(rows)), [text for text, _, _ in reversed(rows)])
    axis.tick_params(axis="y", length=0)
    return figure


@styled
def statistics(found: Mapping[str, Reals], real: Mapping[str, Reals] | None) -> Figure:
    """Draw the distance of each published row, and the spectra of the scene and of the real trace."""
    figure, (far, spectra) = grid(1, 2, (11, 4.6), widths=[1.2, 1])
    rows = [row for row in TABLE if row.low and row.key in found][::-1]
    values = [row.distance(found[row.key]) for row in rows]
    far.barh(range(len(rows)), values, color=MAIN, height=0.6)
    far.plot(np.zeros(len(rows)), range(len(rows)), ".", color=MAIN)
    far.set_yticks(range(len(rows)), [row.key for row in rows])
    far.tick_params(axis="y", length=0)
    far.set(xlabel="distance from the published range (0: inside)", title="Where the scene differs")
    for name, colour in (("slip", SECOND), ("static", MAIN)):
        spectra.plot(FREQUENCIES, found[f"{name} spectrum"], "o-", color=colour, label=f"{name}, simulated")
        if real is not None:
            spectra.plot(FREQUENCIES, real[f"{name} spectrum"], "o--", color=colour, markerfacecolor="white",
                         label=f"{name}, real trace")  # fmt: skip
    _log(spectra, FREQUENCIES)
    spectra.set_yscale("log")
    spectra.set(xlabel="frequency, Hz", ylabel="amplitude, counts", title="Spectra of loaded barometers")
    spectra.legend()
    return figure


@styled
def ablation(found: Ablation) -> Figure:
    """Draw the change of each measure without each term, with two sigma."""
    names = sorted(found.change, key=lambda name: float(found.effect(name)[0]), reverse=True)
    columns = len(found.measures)
    figure, axes = grid(1, columns, (2.6 + 2.3 * columns, 0.9 + 0.26 * len(names)), sharey=True)
    for column, (axis, measure) in enumerate(zip(axes, found.measures, strict=True)):
        axis.axvline(0, color=FAINT, linewidth=0.8)
        for place, name in enumerate(names):
            effect, error = found.effect(name)[column], 2 * found.sigma(name)[column]
            clear = abs(effect) >= error
            axis.errorbar(effect, place, xerr=error, fmt="o", color=MAIN if clear else FAINT, markersize=5,
                          linewidth=1)  # fmt: skip
        axis.set(title=measure, xlabel="change")
        axis.tick_params(axis="y", length=0)
    axes[0].set_yticks(
        range(len(names)), [f"{'without' if name in TERMS else 'with'} {name}" for name in names]
    )
    return figure


@styled
def speed(found: Speed) -> Figure:
    """Draw the speed against nodes and fingertips."""
    figure, (nodes, fingertips) = grid(1, 2, (8.5, 3.2))
    nodes.plot(list(found.by_nodes), list(found.by_nodes.values()), "o-", color=MAIN)
    nodes.plot(24, MARK, "D", color=FAINT)
    nodes.annotate("mark", (24, MARK), (8, 0), textcoords="offset points", va="center", color=FAINT)
    nodes.set(
        xlabel="nodes of the pad", ylabel="simulated s per CPU s", ylim=(0, None), title="One fingertip"
    )
    nodes.set_xticks(list(found.by_nodes))
    number = np.array(list(found.by_fingertips))
    cost = 1000 / np.array(list(found.by_fingertips.values()))
    fingertips.plot(number, cost, "o-", color=MAIN)
    fingertips.plot(number, cost[0] * number, ":", color=FAINT, label="in proportion")
    fingertips.set(
        xlabel="fingertips", ylabel="CPU ms per simulated s", title="Several fingertips", ylim=(0, None)
    )
    fingertips.set_xticks(number.tolist())
    fingertips.legend()
    return figure


def _log(axis: Axes, ticks: Sequence[float]) -> None:
    axis.set_xscale("log")
    axis.set_xticks(list(ticks), [f"{tick:g}" for tick in ticks])
    axis.minorticks_off()
