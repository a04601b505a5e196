"""Reports of the tap and lift experiments: success next to the paper's, failures, costs and false slips."""

from collections.abc import Callable, Mapping, Sequence
from math import isfinite
from typing import Any, Final

import numpy as np

from connectors.sim.objects import named
from connectors.sim.truth import SLIDING
from flows.lab.experiments import lift_trial, tap_trial
from flows.lab.experiments.lift_trial import LiftOutcome, lift
from flows.lab.experiments.study import Experiment, Method, Result, Results, median
from flows.lab.experiments.tap_trial import TapOutcome, tap
from flows.lab.experiments.trial import BASELINE, Trace, Trial
from flows.learn.onsets import runs
from flows.report.figures import CELLS, FAINT, INK, MAIN, SECOND, SHADE, Axes, Figure, grid, styled
from flows.report.report_page import Report, Section
from flows.report.table import Table, Value, show
from storage import load_detector

# success of 20 trials with real objects (%), "Under Pressure" (2021)
PAPER_TAP: Final = {
    "ball": 90,
    "box": 85,
    "cardboard_can": 90,
    "football_sleeve": 90,
    "foam_sleeve": 80,
    "metal_can": 90,
}
PAPER_LIFT: Final = {
    "ball": 35,
    "box": 100,
    "cardboard_can": 85,
    "football_sleeve": 85,
    "foam_sleeve": 35,
    "metal_can": 95,
}
QUIET: Final = 2.1  # s of each soft tap trial in which nothing is done to the object
EXAMPLE: Final = "ball"  # object of the figure: one of the two hardest in the paper's lift


def tap_report(results: Results[TapOutcome], command: str) -> Report:
    """Report the tap experiment that `command` ran."""
    finding = _finding(results, "registers the blow, and static after it,", PAPER_TAP)
    sections = [
        _successes("tap", results, finding, PAPER_TAP, tap),
        _failures(results),
        _false_slips(results),
    ]
    return _report("Mallet tap", results, sections, command)


def lift_report(results: Results[LiftOutcome], command: str) -> Report:
    """Report the lift experiment that `command` ran."""
    finding = _finding(results, "holds", PAPER_LIFT)
    sections = [_successes("lift", results, finding, PAPER_LIFT, lift), _failures(results), _costs(results)]
    return _report("Object lift", results, sections, command)


def condition_table(results: Mapping[str, Results[LiftOutcome]], method: Method, caption: str = "") -> Table:
    """Return the success of a method under each of several conditions, with the costs of its lifts."""
    names = next(iter(results.values())).trials.objects
    costs = ["mean", "lost", "slide mm", "force", "false"]
    rows: list[list[Value]] = []
    for condition, found in results.items():
        lifts = found.of(method)
        rows.append(
            [
                condition,
                *(found.success(method, name) for name in names),
                found.mean(method),
                100 * float(np.mean([each.lost for each in lifts])),
                median([each.slide for each in lifts]),
                median([each.ratio for each in lifts]),
                float(np.mean([each.false for each in lifts])),
            ]
        )
    head = ["condition", *map(title, names), *costs]
    return Table(head, rows, caption, {"force": 2, **dict.fromkeys(map(title, names), 0)})


def title(name: str) -> str:
    """Return an object's name as shown in tables and figures."""
    return name.replace("_", " ")


def _report(experiment: str, results: Results[Result], sections: Sequence[Section], command: str) -> Report:
    """Return the report; the facts in its JSON are those of the first method."""
    trials, first = results.trials, results.methods[0]
    text = (
        f"{trials}, the same for all methods, from seed {trials.seed}, in the simulated scene; the paper "
        "used real objects. docs/explanations/experiments.md defines success and lists the assumptions."
    )
    facts: dict[str, Any] = {
        "experiment": sections[0].name,
        "trials": trials.count,
        "seed": trials.seed,
        "method": str(first),
        "mean_success": results.mean(first),
        "objects": {name: results.success(first, name) for name in trials.objects},
        "failures": dict(results.failures(first)),
    }
    return Report(f"{experiment}: {sections[0].finding}", text, sections, command, facts)


def _finding(results: Results[Result], verb: str, paper: Mapping[str, int]) -> str:
    first, trials = results.methods[0], results.trials
    outcomes = results.of(first)
    theirs = float(np.mean([paper[name] for name in trials.objects]))
    return (
        f"{first} {verb} in {sum(each.success for each in outcomes)} of {len(outcomes)} trials "
        f"({show(results.mean(first))} %); the paper in {show(theirs)} % of its own"
    )


def _successes(
    name: str,
    results: Results[Result],
    finding: str,
    paper: Mapping[str, int],
    experiment: Experiment[Result],
) -> Section:
    """Return the section about success by object next to the paper's, with the figure of a trial."""
    objects = results.trials.objects
    rows: list[list[Value]] = [
        [str(method), *(results.success(method, each) for each in objects), results.mean(method)]
        for method in results.methods
    ]
    theirs = [float(paper[each]) for each in objects]
    rows.append(["paper, real objects", *theirs, float(np.mean(theirs))])
    table = Table(
        ["success, %", *map(title, objects), "mean"], rows, decimals=dict.fromkeys(map(title, objects), 0)
    )
    text = f"{results.trials}."
    return Section(name, finding, text, [table], lambda: trial_figure(results, experiment))


def _failures(results: Results[Result]) -> Section:
    """Return the section about failed trials, by ending."""
    rows: list[list[Value]] = [
        [str(method), title(name), ", ".join(f"{count} {ending}" for ending, count in failed.items())]
        for method in results.methods
        for name in results.trials.objects
        if (failed := results.failures(method, name))
    ]
    first = results.methods[0]
    failures = results.failures(first)
    finding = f"{first} fails in {failures.total()} of {len(results.of(first))} trials"
    if failures:
        finding += f", mostly: {failures.most_common(1)[0][0]}"
    table = Table(["method", "object", "endings"], rows)
    return Section("failures", finding, "Failed trials by ending.", [table])


def _costs(results: Results[LiftOutcome]) -> Section:
    """Return the section about slides and holding forces."""

    def cells(lifts: Sequence[LiftOutcome]) -> list[Value]:
        slides = [each.slide for each in lifts]
        return [
            median(slides),
            float(np.quantile(slides, 0.9)),
            median([each.delay for each in lifts]),
            median([each.ratio for each in lifts]),
            median([each.peak for each in lifts]),
            float(np.mean([each.false for each in lifts])),
        ]

    first = results.methods[0]
    slide, _, _, force, *_ = cells(results.of(first))
    held = f"with {show(force, 2)} times the least force" if isfinite(float(force or 0)) else "nothing"
    head = ["method", "object", "slide mm", "p90 mm", "delay ms", "force", "peak", "false slips"]
    return Section(
        "costs",
        f"{first} lets objects slide by {show(slide)} mm and holds {held}",
        "Medians. Slide: from the start of the lift, all trials. Delay: from the first sliding to the "
        "registered slip. Force: mean of the last second over the least that holds, trials that hold; peak: "
        "highest of the trial. False slips: registered before anything slid, per trial.",
        [Table(head, _rows(results, cells), decimals={"force": 2, "peak": 2})],
    )


def _false_slips(results: Results[TapOutcome]) -> Section:
    """Return the section about slips registered where nothing slips."""

    def cells(taps: Sequence[TapOutcome]) -> list[Value]:
        return [
            median([each.slide for each in taps]),
            median([each.delay for each in taps]),
            sum(each.drawn for each in taps),
            100 * float(np.mean([each.false_lift > 0 for each in taps])),
            100 * float(np.mean([each.false_tap > 0 for each in taps])),
            float(np.mean([each.false_hold for each in taps])) * 60 / QUIET,
        ]

    first = results.methods[0]
    *_, lifted, hit, _ = cells(results.of(first))
    head = [
        "method",
        "object",
        "slide mm",
        "delay ms",
        "blows drawn",
        "lift %",
        "soft blow %",
        "hold, per min",
    ]
    return Section(
        "false-slips",
        f"{first} registers a false slip at {show(lifted)} % of firm lifts and {show(hit)} % of soft blows",
        "The same grasp, lifted with that firm grip and hit too softly to slide: shares of trials in which "
        "a slip is registered. Slide and delay are medians for the blow that moves the object; a blow that "
        f"moved it by less than {tap_trial.LEAST_SLIDE:g} mm or more than {tap_trial.MOST_SLIDE:g} mm was "
        "drawn again.",
        [Table(head, _rows(results, cells))],
    )


def _rows(results: Results[Result], cells: Callable[[Sequence[Result]], list[Value]]) -> list[list[Value]]:
    """Return a row for each method and object, and one for all objects of a method."""
    return [
        [str(method), title(name) or "all", *cells(results.of(method, name))]
        for method in results.methods
        for name in (*results.trials.objects, "")
    ]


@styled
def trial_figure(results: Results[Result], experiment: Experiment[Result]) -> Figure:
    """Draw the first trial of the first method with the ball, or else the first object."""
    trials, method = results.trials, results.methods[0]
    held = named(EXAMPLE if EXAMPLE in trials.objects else trials.objects[0])
    rule, detector = method.controller(), load_detector(method.detector)
    trace, outcome = experiment(held, trials.seed, detector, rule, results.conditions)
    least = Trial.draw(held, trials.seed, results.conditions).least_force
    figure, axes = grid(5, 1, (9, 8), sharex=True)
    force, counts, probability, slide, height = axes
    t = trace.t
    force.plot(t, trace.commanded, color=FAINT, drawstyle="steps-post", label="commanded")
    force.plot(t, trace.force, color=MAIN, label="normal force")
    force.axhline(least, color=SECOND, linestyle="--", linewidth=0.9, label="least that holds")
    top = 1.3 * max(float(trace.commanded.max()), least)  # leaves room for the legend
    force.set(ylabel="N", ylim=(0, top), title=f"{method}: {title(held.name)}, {outcome.ending}")
    force.legend(loc="upper left", ncols=3)
    for cell, color in enumerate(CELLS):
        counts.plot(t, trace.counts[:, cell], color=color, linewidth=0.8)
    counts.set(ylabel="counts", title="Barometers")
    probability.plot(t, trace.probability, color=INK)
    probability.axhline(rule.threshold, color=FAINT, linestyle="--", linewidth=0.9)
    probability.set(ylabel="", ylim=(0, 1), title="Probability of slip (shaded: the object slides)")
    slide.plot(t, 1000 * trace.slide, color=MAIN)
    slide.set(ylabel="mm", title="Slide along the pad")
    height.plot(t, 1000 * trace.gripper_height, color=FAINT, label="gripper")
    height.plot(t, 1000 * trace.height, color=MAIN, label="object")
    height.set(ylabel="mm", title="Height", xlabel="s", xlim=(BASELINE, t[-1]))
    height.legend(loc="upper left")
    tapped = isinstance(outcome, TapOutcome)
    for axis in axes:
        _shade(axis, trace)
        axis.axvline(
            tap_trial.BLOW if tapped else lift_trial.LIFT.instant,
            color=SECOND if tapped else FAINT,
            linewidth=0.8,
        )
    return figure


def _shade(axis: Axes, trace: Trace) -> None:
    """Shade the times in which the object slides."""
    for first, end in runs(trace.speed > SLIDING).tolist():
        axis.axvspan(trace.t[max(first - 1, 0)], trace.t[end - 1], color=SHADE, linewidth=0)
