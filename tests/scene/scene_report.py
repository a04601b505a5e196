"""The report on the simulated scene: realism, the worth of each of its terms, and speed."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, TypeAlias

import numpy as np

from connectors.sim.paper_plan import PaperPlan
from connectors.sim.scene import Move, Moves, Scene
from flows.learn.evaluation.evaluation_figures import motion as motion_figure
from flows.learn.evaluation.motion_metrics import MotionConfusions, MotionKind
from flows.learn.evaluation.published import SURFACES, TABLE_1, TABLE_3
from flows.learn.evaluation.sample_metrics import Confusion
from flows.learn.labelled_recordings import LabelledRecording, simulated_recording
from flows.report.report_page import Report, Section
from flows.report.table import Table, Value
from operators.batch import Reals
from operators.detectors import Detector
from tests.scene import scene_figures
from tests.scene.scene_ablation import DISTANCE, GRIDS, TERMS, Ablation, ablate
from tests.scene.scene_judges import confusion
from tests.scene.scene_measurements import DEFAULT, LOGISTIC, NETWORK, Measurements
from tests.scene.scene_motion import EFFECTS, f1_difference, groups, motion_name, spaced
from tests.scene.scene_speed import speed
from tests.scene.scene_statistics import RATE, TABLE, distance, measure
from tests.scene.scene_targets import CROSS_CHECK, target_table

GOAL_JUDGE: Final = 88.0  # %, accuracy of the paper's TCN on the simulation
GOAL_TRACE: Final = 90.0  # %, balanced, of a detector trained on the simulation only, on the real trace
GOAL_PLAN: Final = 10.0  # CPU s for the whole plan
_BEFORE: Final = 200  # samples of a recording before the shown part
NO_JUDGE: Final = "**Skipped: the paper's TCN, because no `--judge` was given.**"
NO_TRACE: Final = "**Skipped: the real trace, because no `--trace` was given.**"
FITTING: Final = (
    "`make scene-fit` fits all constants of the scene together: to the F1 of the paper's TCN, whose weights "
    "come from real recordings, by surface and by motion; to the published statistics; to the relaxation of "
    "real barometers under rubber; and to the shape of the spectrum of a real trace. It simulates seeds from "
    "1000 on; the figures on this page are those of other seeds. They measure the fit, not generalisation: "
    "the network and the statistics are targets, and the motion effects follow from targets. The score on "
    "the real trace is not a target, but it was known when the inputs of the default detector were chosen. "
    "Other networks and another real trace are held out."
)


def scene_report(measured: Measurements, command: str) -> Report:
    """Measure everything and report it; `command` repeats the study."""
    sections = list[Section]()
    for section in (_traces, _realism, _statistics, _ablation, _motion, _speed):
        measured.log(f"section: {section.__name__.strip('_')}")
        sections.append(section(measured))
    return Report("The simulated scene, measured", FITTING, sections, command)


def _traces(of: Measurements) -> Section:
    """Show recordings to the eye."""
    shown = list[tuple[str, LabelledRecording, int]]()
    wanted = [(surface, 0.075) for surface in SURFACES] + [("plane", None), ("sphere", None), ("plane", 0.1)]
    for surface, pace in wanted:
        for each in of.recordings:
            if (each.surface, each.speed) == (surface, pace):
                shown.append(
                    (
                        f"{spaced(surface)}, {'rotation' if pace is None else f'{100 * pace:g} cm/s'}",
                        each,
                        _BEFORE,
                    )
                )
                break
    shown.append(
        ("hold: grip change, taps, lift", simulated_recording(still(of.size.plan), of.seed), _BEFORE)
    )
    if of.trace is not None:
        shown.append((f"real: {of.trace.surface}", of.trace, 0))
    text = (
        "Seconds 2 to 6 of the first recording of each kind: zeroed counts of the six barometers, the true "
        "normal force, and, shaded, the label by arm speed. Counts fall as pressure rises."
    )
    finding = "Simulated recordings" + ("" if of.trace is None else " and a real one")
    return Section("traces", finding, _noted(text, of, trace=True), draw=lambda: scene_figures.traces(shown))


def still(plan: PaperPlan) -> Scene:
    """Return a scene in which the arm stands still, but force, taps and lifts change the signal."""
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


Mark: TypeAlias = tuple[str, float, bool]  # text, %, and True for a value to compare with


@dataclass
class _Realism:
    """Findings, tables and marks of the realism section."""

    findings: list[str] = field(default_factory=list[str])
    texts: list[str] = field(default_factory=list[str])
    tables: list[Table] = field(default_factory=list[Table])
    marks: list[Mark] = field(default_factory=list[Mark])


def _realism(of: Measurements) -> Section:
    """Evaluate a network trained on real data, and a real trace."""
    found = _Realism()
    if NETWORK in of.by_motion:
        _evaluate_network(of, of.by_motion[NETWORK], found)
    detectors: dict[str, Detector] = {"PSD threshold": of.psd, LOGISTIC: of.logistic}
    detectors |= {f"{name}, shipped": detector for name, detector in of.shipped.items()}
    home = {name: confusion(detector, of.recordings, of.size.hop) for name, detector in detectors.items()}
    if of.trace is None:
        rows: list[list[Value]] = [[name, each.balanced] for name, each in home.items()]
        caption = f"Fitted to {of.fitted_to}, or shipped; balanced accuracy"
        found.tables.append(Table(["detector", "on the simulation %"], rows, caption))
        found.marks += [(f"{name} on the simulation", each.balanced, False) for name, each in home.items()]
    else:
        _evaluate_on_trace(of, of.trace, detectors, home, found)
        if of.network is not None:
            seeds = CROSS_CHECK[: of.size.seeds]
            found.tables.append(target_table(of.size.reduced, seeds, of.network, of.trace))
    finding = "; ".join(found.findings) or "realism was not evaluated with real data"
    marks = found.marks
    return Section(
        "realism",
        finding[0].upper() + finding[1:],
        _noted(" ".join(found.texts), of, judge=True, trace=True),
        found.tables,
        lambda: scene_figures.realism(marks, "accuracy (on the trace: balanced), %"),
    )


def _evaluate_network(of: Measurements, network: MotionConfusions, found: _Realism) -> None:
    """Evaluate the paper's TCN on the simulation."""
    accuracy = network.confusion().accuracy
    rows = [_group_row(name, network.confusion(group), paper) for name, group, paper in groups()]
    head = ["windows", "number", "accuracy %", "static %", "slip %", "F1 %", "paper's F1 %"]
    found.tables.append(Table(head, rows, "The paper's TCN on the simulation"))
    found.findings.append(
        f"a network trained on real data is right on {accuracy:.1f} % of the simulation "
        f"({_goal(accuracy, GOAL_JUDGE)})"
    )
    found.texts.append(
        f"The paper's TCN, with its published weights and standardisation, on every {of.size.hop}th window "
        f"of the {len(of.recordings)} recordings of the plan (seed {of.seed}). The weighted F1 of the "
        "paper's Table III is on its real test set."
    )
    found.marks += [
        ("paper's TCN on the simulation", accuracy, False),
        ("goal", GOAL_JUDGE, True),
        ("paper's TCN on its own test set", TABLE_1["TCN"][0], True),
    ]


def _evaluate_on_trace(
    of: Measurements,
    trace: LabelledRecording,
    detectors: dict[str, Detector],
    home: dict[str, Confusion],
    found: _Realism,
) -> None:
    """Evaluate all detectors on the real trace."""
    there = {name: confusion(detector, [trace], 1) for name, detector in detectors.items()}
    chosen = there[f"{DEFAULT}, shipped"].balanced  # not the best one: the default
    found.findings.append(
        f"the default detector, trained on the simulation only, on {chosen:.1f} % of a real trace "
        f"({_goal(chosen, GOAL_TRACE)})"
    )
    found.marks += [
        (f"{name}, of the simulation, on the trace", there[name].balanced, False) for name in there
    ]
    if of.network is not None:
        there[NETWORK], home[NETWORK] = confusion(of.network, [trace], 1), of.by_motion[NETWORK].confusion()
        found.marks.append((f"{NETWORK} on the trace", there[NETWORK].balanced, False))
    found.marks.append(("goal on the trace", GOAL_TRACE, True))
    found.texts.append(
        f"Two simple detectors fitted to {of.fitted_to}, and the shipped networks, trained on simulated "
        f"recordings only (see their model cards), on the {len(trace.evaluated(1))} windows of the real "
        f"trace `{trace.surface}` (balanced accuracy). Neighbouring windows are alike and the trace holds "
        "few strokes, so this is weak evidence: networks that differ only in their seed differ here by ten "
        "points."
    )
    head = ["detector", "fitted to", "simulation %", "trace %", "trace, static %", "trace, slip %"]
    rows: list[list[Value]] = [
        [
            name,
            "simulation" if name in detectors else "real recordings",
            home[name].balanced,
            each.balanced,
            *each.recalls,
        ]
        for name, each in there.items()
    ]
    found.tables.append(Table(head, rows, "All detectors on the simulation and on the real trace"))


def _group_row(name: str, found: Confusion, paper: float) -> list[Value]:
    return [name, int(found.counts.sum()), found.accuracy, *found.recalls, found.f1, paper]


def _statistics(of: Measurements) -> Section:
    """Compare statistics of the signal with the published ones and the real trace."""
    found = measure(of.recordings)
    real = None if of.trace is None else measure([of.trace])
    rows: list[list[Value]] = []
    for row in TABLE:
        if row.key in found:
            span = _numbers(row.low) + (f" to {_numbers(row.high)}" if row.high else "")
            off = row.distance(found[row.key]) if row.low else None
            trace = "" if real is None or row.key not in real else _numbers(real[row.key])
            rows.append([row.text, _numbers(found[row.key]), span, off, trace])
    distances = [row.distance(found[row.key]) for row in TABLE if row.low and row.key in found]
    far = distance(found)
    text = (
        "*Distance* of a row: how far its values lie outside the published range, in units of the published "
        "standard deviation for levels and of the middle of the range otherwise, averaged over the "
        f"barometers; of the scene: the mean of the rows, **{far:.2f}**. At 0 the published figures would "
        "not distinguish the scene from real recordings. Values by barometer are in the order 0 to 5. The "
        "published figures are "
        'those of "Under Pressure" (2021) and of its authors\' public logs and plots; the real trace is one '
        "short recording on another material, for scale."
    )
    if real is not None:
        here, there = found["slip spectrum"][0], real["slip spectrum"][0]
        text += (
            f" At 2 Hz the load moves by {here:.0f} counts in simulated slip, by {there:.0f} in the trace."
        )
    return Section(
        "statistics",
        f"{sum(each == 0 for each in distances)} of {len(distances)} statistics lie within the published "
        f"range; the distance is {far:.2f}",
        _noted(text, of, trace=True),
        [Table(["statistic", "simulated", "published", "distance", "real trace"], rows, "", {"distance": 2})],
        lambda: scene_figures.statistics(found, real),
    )


def _numbers(values: Sequence[float] | Reals) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def _ablation(of: Measurements) -> Section:
    """Remove each term of the scene."""
    variants = {name: change for name, change in {**TERMS, **GRIDS}.items() if name in of.size.terms}
    seeds = range(of.seed, of.seed + of.size.seeds)
    found = ablate(of.size.reduced, seeds, of.network, variants, hop=of.size.hop + 3, log=of.log)
    terms, grids = ([name for name in variants if name in group] for group in (TERMS, GRIDS))
    unclear = found.unclear(terms)
    text = (
        f"The same {of.size.seeds} seeds of a reduced plan with and without each term: change and one sigma, "
        "the standard error over the seeds, but at least the median of all rows; **bold** is two sigma or "
        "more. The network is the paper's TCN, evaluated as above (accuracy). The detectors are fitted to "
        "the scene without the term and evaluated, by balanced accuracy, on other recordings of the whole "
        f"scene. A term is clear if it changes one of these {len(found.measures)} measures. Below two sigma "
        f"in every measure: {', '.join(unclear) or 'none'}."
    )
    tables = [
        Table(
            ["without", *found.measures],
            [["(the whole scene)", *_whole(found)], *([name, *_effects(found, name)] for name in terms)],
        )
    ]
    if grids:
        moved = [name for name in grids if name not in found.unclear(grids)]
        tables.append(
            Table(
                ["instead", *found.measures],
                [[name, *_effects(found, name)] for name in grids],
                "Other grids and steps instead of 8 x 6 nodes and 1 ms; two sigma or more: "
                + (", ".join(moved) or "none"),
            )
        )
    finding = f"{len(terms) - len(unclear)} of {len(terms)} terms change a result by two sigma or more"
    if unclear:
        finding += f"; not: {', '.join(unclear)}"
    return Section(
        "ablation", finding, _noted(text, of, judge=True), tables, lambda: scene_figures.ablation(found)
    )


def _whole(found: Ablation) -> list[str]:
    """Return mean and standard deviation of the measures of the whole scene."""
    means, deviations = found.whole.mean(axis=0), found.whole.std(axis=0, ddof=1)
    places = [2 if each == DISTANCE else 1 for each in found.measures]
    return [
        f"{mean:.{n}f} (seed sd {sd:.{n}f})" for mean, sd, n in zip(means, deviations, places, strict=True)
    ]


def _effects(found: Ablation, name: str) -> list[str]:
    """Return the change of each measure without a term, bold where it is two sigma or more."""
    texts = list[str]()
    for effect, sigma, each in zip(found.effect(name), found.sigma(name), found.measures, strict=True):
        places = 2 if each == DISTANCE else 1
        text = f"{effect:+.{places}f} ± {sigma:.{places}f}"
        texts.append(f"**{text}**" if abs(effect) >= 2 * sigma else text)
    return texts


def _motion(of: Measurements) -> Section:
    """Compare which motions are easy and which are hard."""
    judge = next(iter(of.by_motion))
    rows: list[list[Value]] = []
    reproduced = list[str]()
    for effect in EFFECTS:
        row = [effect.text, f"{effect.paper:+.1f}"]
        for name, found in of.by_motion.items():
            difference, error = f1_difference(found, effect.first, effect.second, draws=of.size.draws)
            verdict = effect.verdict(difference, error)
            row.append(f"{difference:+.1f} ± {error:.1f}, {verdict}")
            if name == judge and verdict == "reproduced":
                reproduced.append(effect.text.split(",")[0])
        rows.append(list(row))
    text = (
        "Difference of weighted F1 in points, with the standard error of a bootstrap over recordings; an "
        "effect below two of them does not count. The F1 by surface and by motion are targets of the fit."
    )
    return Section(
        "motion",
        f"{len(reproduced)} of {len(EFFECTS)} motion effects of the real data are reproduced "
        f"({', '.join(reproduced) or 'none'})",
        _noted(text, of, judge=True),
        [
            Table(["effect", "paper", *of.by_motion], rows),
            *(_motion_table(name, found) for name, found in of.by_motion.items()),
        ],
        lambda: motion_figure(of.by_motion),
    )


def _motion_table(name: str, found: MotionConfusions) -> Table:
    rows: list[list[Value]] = []
    for (kind, pace), paper in TABLE_3.items():
        each = [found.at(MotionKind(kind, pace, surface)) for surface in SURFACES]
        each.append(Confusion(np.sum([one.counts for one in each], axis=0)))
        values = [f"{one.f1:.1f} ({theirs:.1f})" for one, theirs in zip(each, paper, strict=True)]
        rows.append([motion_name(kind, pace), *values])
    head = ["motion", *map(spaced, SURFACES), "all"]
    return Table(head, rows, f"F1 (%) of the {name}, the paper's in brackets")


def _speed(of: Measurements) -> Section:
    """Time the simulation."""
    found = speed(of.size.plan, of.size.timed)
    coarse, mark = found.by_nodes[24], scene_figures.MARK
    samples = sum(map(len, of.recordings))
    several = {number: value for number, value in found.by_fingertips.items() if number > 1}
    speeds = {
        **{f"one fingertip, {nodes} nodes": value for nodes, value in found.by_nodes.items()},
        "one fingertip, sample by sample, as in a live run": found.single,
        **{f"{number} fingertips": value for number, value in several.items()},
    }
    rows = list(speeds.items())
    text = (
        "Simulated seconds per CPU second of one core, compiled, the best of three runs of "
        f"{of.size.timed:g} s on endless strokes (shorter for several fingertips). The mark is {mark} at 24 "
        f"nodes; several fingertips count as one scene. The plan's {samples} samples with alignment and "
        f"labels took {of.simulating:.1f} CPU s ({_goal(-of.simulating, -GOAL_PLAN)})."
    )
    return Section(
        "speed",
        f"{found.by_nodes[48]:.0f} simulated seconds per CPU second, {coarse:.0f} at 24 nodes "
        f"({_goal(coarse, mark, 'mark')}); the plan of {samples / RATE / 60:.0f} minutes in "
        f"{of.simulating:.1f} s",
        text,
        [Table(["scene", "simulated s per CPU s"], rows, "", {"simulated s per CPU s": 0})],
        lambda: scene_figures.speed(found),
    )


def _goal(value: float, goal: float, name: str = "goal") -> str:
    """Return whether a value reaches a goal; negative values are limits from above."""
    return f"{name} {abs(goal):g}: {'reached' if value >= goal else 'missed'}"


def _noted(text: str, of: Measurements, *, judge: bool = False, trace: bool = False) -> str:
    """Return the text with a note for each file that a section needs and that was not given."""
    notes = [NO_JUDGE] * (judge and of.network is None) + [NO_TRACE] * (trace and of.trace is None)
    return "\n\n".join(part for part in (text, *notes) if part)
