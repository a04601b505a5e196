"""The sections of the scene's report: each a finding, its table, and the figure that shows it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from connectors.sim.paper_plan import Collection
from connectors.sim.scene import Move, Moves, Scene
from flows.learn.evaluation.evaluation_figures import motion as motion_figure
from flows.learn.evaluation.motion_metrics import Cell, Cells, Chosen
from flows.learn.evaluation.published import SURFACES, TABLE_1, TABLE_3, TABLE_3_ANY
from flows.learn.evaluation.sample_metrics import Confusion
from flows.learn.labelled_recordings import LabelledRecording, simulated_recording
from flows.report.figures import Figure
from operators.batch import Reals
from operators.detectors import Detector
from tests.scene import scene_figures
from tests.scene.scene_ablation import DISTANCE, GRIDS, TERMS, ablate
from tests.scene.scene_judges import confusion
from tests.scene.scene_measured import DEFAULT, NETWORK, Measured
from tests.scene.scene_motion import EFFECTS
from tests.scene.scene_speed import speed
from tests.scene.scene_statistics import RATE, TABLE, distance, measure

GOAL_JUDGE: Final = 82.0  # %, accuracy of the paper's TCN on the simulation
GOAL_TRACE: Final = 90.0  # %, balanced, on the real trace, of a detector that knows the simulation only
GOAL_PLAN: Final = 10.0  # CPU s for the whole plan
_SHOWN: Final = 200  # samples of a recording before what is shown
SKIPPED_JUDGE: Final = "**Skipped: the paper's TCN, because no `--judge` was given.**"
SKIPPED_TRACE: Final = "**Skipped: the real trace, because no `--trace` was given.**"


@dataclass(frozen=True, slots=True)
class Section:
    """A finding: its title says it, `text` shows what it rests on."""

    title: str
    text: str
    figure: Figure


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; all columns but the first to the right."""
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def traces(of: Measured) -> Section:
    """The figure that a person would look at."""
    shown = list[tuple[str, LabelledRecording, int]]()
    wanted = [(surface, 0.075) for surface in SURFACES] + [("plane", None), ("sphere", None), ("plane", 0.1)]
    for surface, pace in wanted:
        for one in of.trials:
            if (one.surface, one.speed) == (surface, pace):
                how = "rotation, 1 rad/s" if pace is None else f"{100 * pace:g} cm/s"
                shown.append((f"{surface.replace('_', ' ')}, {how}", one, _SHOWN))
                break
    shown.append(("hold: grip change, taps, lift", simulated_recording(still(of.size.plan), of.seed), _SHOWN))
    if of.trace is not None:
        shown.append((f"real: {of.trace.surface}", of.trace, 0))
    beside = "" if of.trace is None else " beside a real one"
    text = (
        "Seconds 2 to 6 of the first recording of each kind, not chosen by eye: zeroed counts of the six "
        "barometers, the true normal force, and, shaded, the label that the arm's speed gives. Counts fall "
        "as pressure rises." + ("" if beside else f"\n\n{SKIPPED_TRACE}")
    )
    return Section(f"What simulated recordings look like{beside}", text, scene_figures.traces(shown))


def still(plan: Collection) -> Scene:
    """A scene in which the arm never moves, but everything else happens."""
    grip = plan.force
    return Scene(
        Moves(
            (
                Move("hold", 1.2, force=0.0),
                Move("hold", 1.2, force=grip),
                Move("hold", 0.8, force=2 * grip),
                Move("tap", 0.5, 0.1, tap=3.0),
                Move("tap", 0.5, 0.1, 90.0, tap=3.0),
                Move("lift", 0.5, force=0.0, settle=0.2),
                Move("hold", 1.8, force=grip),
            )
        ),
        acceleration=plan.acceleration,
        parameters=plan.parameters,
    )


def realism(of: Measured) -> Section:
    """Judged by a network that knows real data only, and by a real trace."""
    parts = [_by_network(of), _by_trace(of)]
    title = "; ".join(title for title, _, _ in parts if title) or "realism was not judged by real data"
    text = "\n\n".join(text for _, text, _ in parts)
    marks = [mark for _, _, marks in parts for mark in marks]
    figure = scene_figures.realism(marks, "accuracy (on the trace: balanced), %")
    return Section(title[0].upper() + title[1:], text, figure)


Mark: TypeAlias = tuple[str, float, bool]  # text, %, and whether it is something to compare with


def _by_network(of: Measured) -> tuple[str, str, list[Mark]]:
    """Title, text and marks."""
    if (cells := of.cells.get(NETWORK)) is None:
        return "", SKIPPED_JUDGE, []
    accuracy = cells.confusion().accuracy
    text = (
        "The paper's TCN, with its published weights and standardisation and no adaptation, on each "
        f"{of.size.hop}th window of the {len(of.trials)} recordings of the plan (seed {of.seed}). Weighted "
        "F1 stands beside that of the paper's Table III, on its real test set.\n\n"
    )
    rows = [_row(name, cells.confusion(chosen), paper) for name, chosen, paper in groups()]
    text += table(["windows", "number", "accuracy %", "static %", "slip %", "F1 %", "paper's F1 %"], rows)
    title = (
        f"a network trained on real data is right on {accuracy:.1f} % of the simulation "
        f"({_goal(accuracy, GOAL_JUDGE)})"
    )
    marks = [
        ("paper's TCN on the simulation", accuracy, False),
        ("goal", GOAL_JUDGE, True),
        ("paper's TCN on its own test set", TABLE_1["TCN"][0], True),
    ]
    return title, text, marks


def _by_trace(of: Measured) -> tuple[str, str, list[Mark]]:
    """Title, text and marks."""
    detectors: dict[str, Detector] = {"PSD threshold": of.psd, "logistic regression": of.logistic}
    detectors |= {f"{name}, shipped": detector for name, detector in of.shipped.items()}
    home = {name: confusion(detector, of.trials, of.size.hop) for name, detector in detectors.items()}
    if of.trace is None:
        text = f"{SKIPPED_TRACE}\n\nFitted to {of.fitted_to}, on the simulation (balanced accuracy): "
        text += ", ".join(f"{name} {counted.balanced:.1f} %" for name, counted in home.items()) + "."
        return (
            "",
            text,
            [(f"{name} on the simulation", counted.balanced, False) for name, counted in home.items()],
        )
    found = {name: confusion(detector, [of.trace], 1) for name, detector in detectors.items()}
    chosen = f"{DEFAULT}, shipped"  # not the best here: what is used
    title = (
        f"the default detector, trained on the simulation alone, on {found[chosen].balanced:.1f} % of a "
        f"real trace ({_goal(found[chosen].balanced, GOAL_TRACE)})"
    )
    marks = [(f"{name}, of the simulation, on the trace", found[name].balanced, False) for name in found]
    if of.network is not None:
        found[NETWORK], home[NETWORK] = confusion(of.network, [of.trace], 1), of.cells[NETWORK].confusion()
        marks.append((f"{NETWORK} on the trace", found[NETWORK].balanced, False))
    marks.append(("goal on the trace", GOAL_TRACE, True))
    rows = [
        [name, "simulation" if name in detectors else "real recordings"]
        + [f"{value:.1f}" for value in (home[name].balanced, one.balanced, *one.recalls)]
        for name, one in found.items()
    ]
    text = (
        f"Two simple detectors fitted to {of.fitted_to}, and the networks that ship, trained on simulated "
        "recordings only (their cards, `storage/trained/*.json`, say which), on the "
        f"{len(of.trace.evaluated(1))} windows of the real trace `{of.trace.surface}` (balanced accuracy). "
        "Neighbouring windows are alike and the trace holds few strokes, so this is weak evidence: networks "
        "that differ in nothing but their seed differ here by ten points.\n\n"
    )
    head = [
        "detector",
        "fitted to",
        "on the simulation %",
        "on the trace %",
        "static there %",
        "slip there %",
    ]
    return title, text + table(head, rows), marks


def _goal(value: float, goal: float) -> str:
    return f"goal {goal:g}: {'reached' if value >= goal else 'missed'}"


def groups() -> list[tuple[str, Chosen, float]]:
    """Groups of windows that the paper has figures for: name, which cells, its F1 (%)."""

    def on(surface: str) -> Chosen:
        return lambda cell: cell.surface == surface

    def moved(kind: str, pace: float | None) -> Chosen:
        return lambda cell: (cell.kind, cell.speed) == (kind, pace)

    surfaces = [(s.replace("_", " "), on(s), f1) for s, f1 in zip(SURFACES, TABLE_3_ANY, strict=True)]
    motions = [(_named(*motion), moved(*motion), f1[-1]) for motion, f1 in TABLE_3.items()]
    return [("all", lambda _: True, TABLE_1["TCN"][-1]), *surfaces, *motions]


def _named(kind: str, pace: float | None) -> str:
    return f"{kind}, {'1 rad/s' if pace is None else f'{100 * pace:g} cm/s'}"


def _row(name: str, of: Confusion, paper: float) -> list[str]:
    numbers = (of.accuracy, *of.recalls, of.f1, paper)
    return [name, f"{of.counts.sum():.0f}", *(f"{number:.1f}" for number in numbers)]


def statistics(of: Measured) -> Section:
    """Beside the published figures and the real trace."""
    found = measure(of.trials)
    real = None if of.trace is None else measure([of.trace])
    rows = list[list[str]]()
    inside = 0
    published = [row for row in TABLE if row.low and row.key in found]
    for row in TABLE:
        if row.key not in found:
            continue
        off = row.distance(found[row.key]) if row.low else float("nan")
        inside += off == 0
        span = _numbers(row.low) + (f" to {_numbers(row.high)}" if row.high else "")
        beside = "" if real is None or row.key not in real else _numbers(real[row.key])
        rows.append([row.text, _numbers(found[row.key]), span, f"{off:.2f}" if row.low else "", beside])
    slow = ""
    if real is not None:
        here, there = found["slip spectrum"][0], real["slip spectrum"][0]
        slow = f" At 2 Hz the load moves by {here:.0f} counts in simulated slip, by {there:.0f} in the trace."
    far = distance(found)
    text = (
        "*Distance*, of a row: how far its values lie outside the published range, in units of the published "
        "standard deviation for levels and of the middle of the range for all else, averaged over the "
        f"barometers; of the scene: the mean of the rows, **{far:.2f}**. 0 would be a scene that the "
        "published figures cannot tell from the real one. Values by barometer stand in the order 0 to 5. The "
        'published figures are those of "Under Pressure" (2021) and of its authors\' public logs and plots; '
        "the real trace is one short recording on another material, and stands here for scale. Levels per "
        "barometer differ most: in the real recordings the pad seems to have touched with one side, which a "
        f"plan of level poses does not repeat.{slow}\n\n"
        + table(["statistic", "simulated", "published", "distance", "real trace"], rows)
    )
    title = f"{inside} of {len(published)} statistics lie within what is published; the distance is {far:.2f}"
    return Section(title, text, scene_figures.statistics(found, real))


def _numbers(values: Sequence[float] | Reals) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def ablation(of: Measured) -> Section:
    """Every term taken away."""
    variants = {name: change for name, change in {**TERMS, **GRIDS}.items() if name in of.size.terms}
    seeds = range(of.seed, of.seed + of.size.seeds)
    found = ablate(of.size.reduced, seeds, of.network, variants, hop=of.size.hop + 3, told=of.told)
    terms = [name for name in variants if name in TERMS]
    silent = found.silent(terms)
    deviation = found.whole.std(axis=0, ddof=1)

    def line(name: str) -> list[str]:
        effects = zip(found.effect(name), found.sigma(name), found.measures, strict=True)
        return [name, *(_change(effect, sigma, measure == DISTANCE) for effect, sigma, measure in effects)]

    places = [2 if measure == DISTANCE else 1 for measure in found.measures]
    whole = [
        f"{mean:.{n}f} (seed sd {sd:.{n}f})"
        for mean, sd, n in zip(found.whole.mean(axis=0), deviation, places, strict=True)
    ]
    text = (
        f"The same {of.size.seeds} seeds of a reduced plan with and without each term: change and one sigma, "
        "the standard error over the seeds, but not below the median of all rows; **bold** is two sigma or "
        "more. The network is the paper's TCN, judged as above (accuracy). The detectors are fitted to the "
        "scene without the term and judged, by balanced accuracy, on other recordings of the whole scene. "
        f"The title counts a term as clear if it changes one of these {len(found.measures)} measures.\n\n"
        + table(["without", *found.measures], [["(the whole scene)", *whole], *map(line, terms)])
    )
    if others := [name for name in variants if name in GRIDS]:
        moved = [name for name in others if name not in found.silent(others)]
        text += (
            "\n\nOther grids and steps instead of 8 x 6 nodes and 1 ms; "
            + (f"two sigma or more: {', '.join(moved)}." if moved else "none changes anything by two sigma.")
            + "\n\n" + table(["instead", *found.measures], list(map(line, others)))
        )  # fmt: skip
    text += (
        f"\n\nBelow two sigma in every measure: {', '.join(silent)}."
        if silent
        else "\n\nNone is below two sigma."
    )
    text += (
        " Noise, spread of the grip and spread of the pose were, and are no longer part of the scene; what "
        "the collection plan itself holds stays."
    )
    if of.network is None:
        text += f"\n\n{SKIPPED_JUDGE}"
    title = f"{len(terms) - len(silent)} of {len(terms)} terms change a result by two sigma or more"
    if silent:
        title += f"; not: {', '.join(silent)}"
    return Section(title, text, scene_figures.ablation(found))


def _change(effect: float, sigma: float, is_distance: bool) -> str:  # noqa: FBT001 - private
    text = f"{effect:+.2f} ± {sigma:.2f}" if is_distance else f"{effect:+.1f} ± {sigma:.1f}"
    return f"**{text}**" if abs(effect) >= 2 * sigma else text


def motion(of: Measured) -> Section:
    """Which motions are easy and which are hard."""
    first = next(iter(of.cells))
    rows, verdicts = list[list[str]](), list[str]()
    for effect in EFFECTS:
        line = [effect.text, f"{effect.paper:+.1f}"]
        for name, cells in of.cells.items():
            gap, error = cells.gap(effect.first, effect.second)
            line.append(f"{gap:+.1f} ± {error:.1f}, {effect.verdict(gap, error)}")
            if name == first:
                verdicts.append(effect.verdict(gap, error))
        rows.append(line)
    tables = [
        f"F1 (%) by the {name}, the paper's in brackets:\n\n" + _cells(cells)
        for name, cells in of.cells.items()
    ]
    good = [effect.text for effect, verdict in zip(EFFECTS, verdicts, strict=True) if verdict == "reproduced"]
    text = (
        "Difference of weighted F1 in points, with the standard error of a bootstrap over recordings; "
        "no effect counts that is below two of them. No cell was tuned.\n\n"
        + table(["effect", "paper", *of.cells], rows)
        + "\n\n" + "\n\n".join(tables)
    )  # fmt: skip
    if of.network is None:
        text += f"\n\n{SKIPPED_JUDGE}"
    named = ", ".join(name.split(",")[0] for name in good) or "none"
    title = f"{len(good)} of {len(EFFECTS)} motion effects of the real data are reproduced ({named})"
    return Section(title, text, motion_figure(of.cells))


def _cells(cells: Cells) -> str:
    rows = list[list[str]]()
    for (kind, pace), paper in TABLE_3.items():
        each = [cells.at(Cell(kind, pace, surface)) for surface in SURFACES]
        each.append(Confusion(np.sum([one.counts for one in each], axis=0)))
        values = [f"{one.f1:.1f} ({theirs:.1f})" for one, theirs in zip(each, paper, strict=True)]
        rows.append([_named(kind, pace), *values])
    return table(["motion", *(surface.replace("_", " ") for surface in SURFACES), "all"], rows)


def speeds(of: Measured) -> Section:
    """How fast it goes."""
    found = speed(of.size.plan, of.size.timed)
    coarse = found.by_nodes[24]
    samples = sum(map(len, of.trials))
    rows = [[f"one fingertip, {nodes} nodes", f"{value:.0f}"] for nodes, value in found.by_nodes.items()]
    rows.append(["one fingertip, sample by sample, as a live run takes it", f"{found.single:.0f}"])
    rows += [
        [f"{number} fingertips", f"{value:.0f}"]
        for number, value in found.by_fingertips.items()
        if number > 1
    ]
    verdict = "within" if of.simulating < GOAL_PLAN else "above"
    text = (
        "Simulated seconds per CPU second of one core, compiled, the best of three runs of "
        f"{of.size.timed:g} s on endless strokes (shorter for fingertips). The mark is {scene_figures.MARK} "
        f"at 24 nodes; several fingertips count as one scene. The plan's {samples} samples with alignment "
        f"and labels took {of.simulating:.1f} CPU s, {verdict} the goal of {GOAL_PLAN:g}.\n\n"
        + table(["scene", "simulated s per CPU s"], rows)
    )
    title = (
        f"{found.by_nodes[48]:.0f} simulated seconds per CPU second, {coarse:.0f} at 24 nodes "
        f"(mark {scene_figures.MARK}: {'reached' if coarse >= scene_figures.MARK else 'missed'}); "
        f"the plan of {samples / RATE / 60:.0f} minutes in {of.simulating:.1f} s"
    )
    return Section(title, text, scene_figures.speed(found))
