"""Reports of the tap and lift experiments: success next to the paper's, failures, costs and false slips."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import polars as pl

from connectors.sim.objects import named
from connectors.sim.truth import SLIDING
from flows.lab.experiments import lift_trial, tap_trial
from flows.lab.experiments.study import Study
from flows.lab.experiments.tap_trial import TapOutcome
from flows.lab.experiments.trial import BASELINE, Conditions, Trace, Trial
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
SUCCESS: Final = (100 * pl.col("success").mean()).alias("success")  # %


def tap_report(study: Study, command: str) -> Report:
    """Report the tap experiment that `command` ran."""
    finding = _finding(study, "registers the blow, and static after it,", PAPER_TAP)
    sections = [_successes("tap", study, finding, PAPER_TAP), _failures(study), _false_slips(study)]
    return _report("Mallet tap", study, sections, command)


def lift_report(study: Study, command: str) -> Report:
    """Report the lift experiment that `command` ran."""
    finding = _finding(study, "holds", PAPER_LIFT)
    sections = [_successes("lift", study, finding, PAPER_LIFT), _failures(study), _costs(study)]
    return _report("Object lift", study, sections, command)


def study_facts(experiment: str, study: Study, outcomes: pl.DataFrame) -> dict[str, Any]:
    """Return the facts in the JSON of a report; `outcomes` are those of the first method."""
    return {
        "experiment": experiment,
        "trials": study.trials.count,
        "seed": study.trials.seed,
        "method": str(study.methods[0]),
        "mean_success": outcomes.select(SUCCESS).item(),
    }


def title(name: str) -> str:
    """Return an object's name as shown in tables and figures."""
    return name.replace("_", " ")


def _report(experiment: str, study: Study, sections: Sequence[Section], command: str) -> Report:
    outcomes = study.of(study.methods[0])
    text = (
        f"{study.trials}, the same for all methods, from seed {study.trials.seed}, in the simulated scene; "
        "the paper used real objects. docs/explanations/experiments.md defines success and lists the "
        "assumptions."
    )
    facts = {
        **study_facts(sections[0].name, study, outcomes),
        "objects": dict(zip(study.trials.objects, _by_object(outcomes), strict=True)),
        "failures": dict(Counter(outcomes.filter(~pl.col("success"))["ending"])),
    }
    return Report(f"{experiment}: {sections[0].finding}", text, sections, command, facts)


def _by_object(outcomes: pl.DataFrame) -> list[float]:
    """Return the success (%) with each object."""
    return outcomes.group_by("object", maintain_order=True).agg(SUCCESS)["success"].to_list()


def _finding(study: Study, verb: str, paper: Mapping[str, int]) -> str:
    first = study.methods[0]
    outcomes = study.of(first)
    held, success = outcomes["success"].sum(), outcomes.select(SUCCESS).item()
    theirs = float(np.mean([paper[name] for name in study.trials.objects]))
    return (
        f"{first} {verb} in {held} of {len(outcomes)} trials "
        f"({show(success)} %); the paper in {show(theirs)} % of its own"
    )


def _successes(name: str, study: Study, finding: str, paper: Mapping[str, int]) -> Section:
    """Return the section about success by object next to the paper's, with the figure of a trial."""
    successes = {str(method): _by_object(study.of(method)) for method in study.methods}
    successes["paper, real objects"] = [float(paper[each]) for each in study.trials.objects]
    rows: list[list[Value]] = [[method, *each, float(np.mean(each))] for method, each in successes.items()]
    objects = [title(each) for each in study.trials.objects]
    table = Table(["success, %", *objects, "mean"], rows, decimals=dict.fromkeys(objects, 0))
    return Section(name, finding, f"{study.trials}.", [table], lambda: trial_figure(study))


def _failures(study: Study) -> Section:
    """Return the section about failed trials, by ending."""
    failed = study.outcomes.filter(~pl.col("success"))
    rows: list[list[Value]] = []
    for (method, name), part in failed.group_by("method", "object", maintain_order=True):
        endings = ", ".join(f"{count} {ending}" for ending, count in Counter(part["ending"]).items())
        rows.append([str(method), title(str(name)), endings])
    first = study.methods[0]
    failures = Counter(failed.filter(method=str(first))["ending"])
    finding = f"{first} fails in {failures.total()} of {len(study.of(first))} trials"
    if failures:
        finding += f", mostly: {failures.most_common(1)[0][0]}"
    tables = [Table(["method", "object", "endings"], rows)] if rows else []
    return Section("failures", finding, "Failed trials by ending.", tables)


def _costs(study: Study) -> Section:
    """Return the section about slides and holding forces."""
    columns = {
        "slide mm": pl.col("slide").median(),
        "p90 mm": pl.col("slide").quantile(0.9, "linear"),
        "delay ms": pl.col("delay").median(),
        "force": pl.col("ratio").median(),
        "peak": pl.col("peak").median(),
        "false slips": pl.col("false").mean(),
    }
    first = study.methods[0]
    found = study.of(first).select(**columns).row(0, named=True)
    held = "nothing" if found["force"] is None else f"with {show(found['force'], 2)} times the least force"
    return Section(
        "costs",
        f"{first} lets objects slide by {show(found['slide mm'])} mm and holds {held}",
        "Medians. Slide: from the start of the lift, all trials. Delay: from the first sliding to the "
        "registered slip. Force: mean of the last second over the least that holds, trials that hold; peak: "
        "highest of the trial. False slips: registered before anything slid, per trial.",
        [_object_table(study, columns, {"force": 2, "peak": 2})],
    )


def _false_slips(study: Study) -> Section:
    """Return the section about slips registered where nothing slips."""
    columns = {
        "slide mm": pl.col("slide").median(),
        "delay ms": pl.col("delay").median(),
        "blows drawn": pl.col("drawn").sum(),
        "lift %": 100 * (pl.col("false_lift") > 0).mean(),
        "soft blow %": 100 * (pl.col("false_tap") > 0).mean(),
        "hold, per min": pl.col("false_hold").mean() * 60 / QUIET,
    }
    first = study.methods[0]
    found = study.of(first).select(**columns).row(0, named=True)
    lifted, hit = show(found["lift %"]), show(found["soft blow %"])
    return Section(
        "false-slips",
        f"{first} registers a false slip at {lifted} % of firm lifts and {hit} % of soft blows",
        "The same grasp, lifted with that firm grip and hit too softly to slide: shares of trials in which "
        "a slip is registered. Slide and delay are medians for the blow that moves the object; a blow that "
        f"moved it by less than {tap_trial.LEAST_SLIDE:g} mm or more than {tap_trial.MOST_SLIDE:g} mm was "
        "drawn again.",
        [_object_table(study, columns)],
    )


def _object_table(
    study: Study, columns: Mapping[str, pl.Expr], decimals: Mapping[str, int | None] | None = None
) -> Table:
    """Return a table with a row for each method and object, and one for all objects of a method."""
    rows: list[list[Value]] = []
    for method in study.methods:
        one = study.of(method)
        both = pl.concat([one, one.with_columns(object=pl.lit("all"))])
        found = both.group_by("object", maintain_order=True).agg(**columns)
        rows += [[str(method), title(name), *values] for name, *values in found.iter_rows()]
    return Table(["method", "object", *columns], rows, decimals=decimals or {})


@styled
def trial_figure(study: Study) -> Figure:
    """Draw the first trial of the first method with the ball, or else the first object."""
    trials, method, conditions = study.trials, study.methods[0], Conditions()
    held = named(EXAMPLE if EXAMPLE in trials.objects else trials.objects[0])
    rule, detector = method.controller(), load_detector(method.detector)
    trace, outcome = study.experiment(held, trials.seed, detector, rule, conditions)
    least = Trial.draw(held, trials.seed, conditions).least_force
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
    event, color = (tap_trial.BLOW, SECOND) if tapped else (lift_trial.LIFT.instant, FAINT)
    for axis in axes:
        _shade(axis, trace)
        axis.axvline(event, color=color, linewidth=0.8)
    return figure


def _shade(axis: Axes, trace: Trace) -> None:
    """Shade the times in which the object slides."""
    for first, end in runs(trace.speed > SLIDING).tolist():
        axis.axvspan(trace.t[max(first - 1, 0)], trace.t[end - 1], color=SHADE, linewidth=0)
