"""Reports of the tap and lift experiments: success next to the paper's, false slips and costs."""

from collections import Counter
from collections.abc import Mapping
from typing import Any, Final

import polars as pl

from connectors.sim.objects import named
from connectors.sim.truth import SLIDING
from flows.lab.experiments import lift_trial, tap_trial
from flows.lab.experiments.rivals import RIVALS
from flows.lab.experiments.study import Study
from flows.lab.experiments.tap_trial import TapOutcome
from flows.lab.experiments.trial import BASELINE, Conditions, Trace, Trial
from flows.learn.onsets import runs
from flows.report.figures import CELLS, FAINT, INK, MAIN, SECOND, SHADE, Axes, Figure, grid, styled
from flows.report.report_page import Report, Section
from flows.report.table import Table, Value, show

# success of 20 trials with real objects (%), "Under Pressure" (2021)
PAPER: Final[Mapping[str, Mapping[str, int]]] = {
    "tap": {
        "ball": 90,
        "box": 85,
        "cardboard_can": 90,
        "football_sleeve": 90,
        "foam_sleeve": 80,
        "metal_can": 90,
    },
    "lift": {
        "ball": 35,
        "box": 100,
        "cardboard_can": 85,
        "football_sleeve": 85,
        "foam_sleeve": 35,
        "metal_can": 95,
    },
}
TITLES: Final = {"tap": "Mallet tap", "lift": "Object lift"}
VERBS: Final = {"tap": "registers both blows, and nothing else,", "lift": "holds, without a false slip,"}
EXAMPLE: Final = "ball"  # object of the figure: one of the two hardest in the paper's lift
SUCCESS: Final = (100 * pl.col("success").mean()).alias("success")  # %
FALSE_FIRM: Final = (100 * pl.col("false_firm").mean()).alias("false_slip_firm")  # %
_COSTS: Final = {  # medians, by experiment
    "tap": {"lead ms": "lead", "slide mm": "slide"},
    "lift": {"force": "force", "peak": "peak", "lead ms": "lead", "slide mm": "slide"},
}
_TEXTS: Final = {
    "tap": "Firm lift: a slip registered from the closing of the gripper to the first blow. Soft blow: one "
    "registered at a blow that moves nothing. Medians over trials: lead, from the registered slip to the "
    "onset of sliding, negative if the slip is registered later; slide at the blows that move the object.",
    "lift": "Firm lift: a slip registered while the same grasp is lifted with a firm grip. Medians over "
    "trials: force of the last second and highest force, relative to the least that holds (force: trials "
    "that hold); lead, from the registered slip to the onset of sliding, negative if the slip is registered "
    "later; slide from the start of the lift.",
}


def experiment_report(study: Study, command: str) -> Report:
    """Report the tap or lift experiment that `command` ran."""
    first = study.of(study.methods[0])
    sections = [_methods(study), _objects(study), _failures(study)]
    text = (
        f"{study.trials}, the same for all methods, from seed {study.trials.seed}, in the simulated scene; "
        "the paper used real objects. docs/explanations/experiments.md defines success and lists the "
        "assumptions."
    )
    facts = {
        **study_facts(study, first),
        "objects": dict(zip(study.trials.objects, _by_object(first), strict=True)),
        "failures": dict(Counter(first.filter(~pl.col("success"))["ending"])),
        "rivals": {
            method.detector: _rates(study.of(method)) for method in study.methods if method.detector in RIVALS
        },
    }
    return Report(f"{TITLES[study.name]}: {sections[0].finding}", text, sections, command, facts)


def study_facts(study: Study, outcomes: pl.DataFrame) -> dict[str, Any]:
    """Return the facts in the JSON of a report; `outcomes` are those of the first method."""
    return {
        "experiment": study.name,
        "trials": study.trials.count,
        "seed": study.trials.seed,
        "method": str(study.methods[0]),
        **_rates(outcomes),
    }


def _rates(outcomes: pl.DataFrame) -> dict[str, float]:
    """Return success and false slips in firm lifts, %."""
    found = outcomes.select(SUCCESS.alias("mean_success"), FALSE_FIRM).row(0, named=True)
    return {name: float(value) for name, value in found.items()}


def interval(hits: int, count: int) -> str:
    """Return Wilson's 95 % confidence interval of a rate, %.

    >>> interval(114, 120), interval(0, 0)
    ('90-98', '-')
    """
    from scipy.stats import binomtest  # noqa: PLC0415 - takes 0.6 s to import

    if not count:
        return "-"
    found = binomtest(hits, count).proportion_ci(method="wilson")
    return f"{100 * found.low:.0f}-{100 * found.high:.0f}"


def title(name: str) -> str:
    """Return an object's name as shown in tables and figures."""
    return name.replace("_", " ")


def _methods(study: Study) -> Section:
    """Return the section that compares the methods, with the figure of a trial."""
    first, costs = study.methods[0], _COSTS[study.name]
    rows = [[str(method), *_cells(study.of(method), costs)] for method in study.methods]
    rates = ["success %", "95 % CI", "firm lift %", "95 % CI "]
    if study.name == "tap":
        rates += ["soft blow %", "95 % CI  "]
    table = Table(["method", *rates, *costs], rows, decimals={"force": 2, "peak": 2})
    found = study.of(first)
    theirs = [PAPER[study.name][name] for name in study.trials.objects]
    finding = (
        f"{first} {VERBS[study.name]} in {found['success'].sum()} of {len(found)} trials "
        f"({show(found.select(SUCCESS).item())} %); "
        f"the paper in {show(sum(theirs) / len(theirs))} % of its own"
    )
    text = f"{_TEXTS[study.name]} Intervals are Wilson's."
    return Section(study.name, finding, text, [table], lambda: trial_figure(study))


def _cells(outcomes: pl.DataFrame, costs: Mapping[str, str]) -> list[Value]:
    """Return the rates with their intervals, and the medians of the costs."""
    rates = [(int(outcomes[each].sum()), len(outcomes)) for each in ("success", "false_firm")]
    if "soft" in outcomes.columns:
        rates.append((int(outcomes["false_soft"].sum()), int(outcomes["soft"].sum())))
    cells: list[Value] = []
    for hits, count in rates:
        cells += [100 * hits / count if count else None, interval(hits, count)]
    medians = outcomes.select(pl.col(each).median() for each in costs.values()).row(0)
    return [*cells, *medians]


def _objects(study: Study) -> Section:
    """Return the section about each object."""
    successes = {str(method): _by_object(study.of(method)) for method in study.methods}
    successes["paper, real objects"] = [float(PAPER[study.name][each]) for each in study.trials.objects]
    objects = [title(each) for each in study.trials.objects]
    rows: list[list[Value]] = [[method, *each, sum(each) / len(each)] for method, each in successes.items()]
    table = Table(["success, %", *objects, "mean"], rows, decimals=dict.fromkeys(objects, 0))
    first, costs = study.methods[0], _COSTS[study.name]
    each_object = study.of(first).group_by("object", maintain_order=True)
    medians = each_object.agg(**{name: pl.col(each).median() for name, each in costs.items()})
    details: list[list[Value]] = [[title(str(name)), *values] for name, *values in medians.iter_rows()]
    least = min(zip(successes[str(first)], objects, strict=True))
    return Section(
        "objects",
        f"{first} is worst with the {least[1]}, {show(least[0])} %",
        "Success by object, and medians of the first method.",
        [table, Table(["object", *costs], details, str(first), {"force": 2, "peak": 2})],
    )


def _by_object(outcomes: pl.DataFrame) -> list[float]:
    """Return the success (%) with each object."""
    return outcomes.group_by("object", maintain_order=True).agg(SUCCESS)["success"].to_list()


def _failures(study: Study) -> Section:
    """Return the section about failed trials, by ending."""
    rows: list[list[Value]] = []
    for method in study.methods:
        failed = study.of(method).filter(~pl.col("success"))
        for (name,), part in failed.group_by("object", maintain_order=True):
            endings = [f"{count} {ending}" for ending, count in Counter(part["ending"]).most_common()]
            rows.append([str(method), title(str(name)), ", ".join(endings)])
    first = study.methods[0]
    failures = Counter(study.of(first).filter(~pl.col("success"))["ending"])
    finding = f"{first} fails in {failures.total()} of {len(study.of(first))} trials"
    if failures:
        finding += f", mostly: {failures.most_common(1)[0][0]}"
    tables = [Table(["method", "object", "endings"], rows)] if rows else []
    return Section("failures", finding, "Failed trials by ending.", tables)


@styled
def trial_figure(study: Study) -> Figure:
    """Draw the first trial of the first method with the ball, or else the first object."""
    trials, method = study.trials, study.methods[0]
    held = named(EXAMPLE if EXAMPLE in trials.objects else trials.objects[0])
    trial, setup = Trial.draw(held, trials.seed, Conditions()), method.load()
    [(trace, outcome)] = study.experiment(trial, [setup])
    least = trial.least_force
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
    probability.axhline(setup[1].threshold, color=FAINT, linestyle="--", linewidth=0.9)
    probability.set(ylabel="", ylim=(0, 1), title="Probability of slip (shaded: the object slides)")
    slide.plot(t, 1000 * trace.slide, color=MAIN)
    slide.set(ylabel="mm", title="Slide along the pad")
    height.plot(t, 1000 * trace.gripper_height, color=FAINT, label="gripper")
    height.plot(t, 1000 * trace.height, color=MAIN, label="object")
    height.set(ylabel="mm", title="Height", xlabel="s", xlim=(BASELINE, t[-1]))
    height.legend(loc="upper left")
    events = tap_trial.BLOWS if isinstance(outcome, TapOutcome) else (lift_trial.LIFT.instant,)
    for axis in axes:
        _shade(axis, trace)
        for event in events:
            axis.axvline(event, color=FAINT, linewidth=0.8)
    return figure


def _shade(axis: Axes, trace: Trace) -> None:
    """Shade the times in which the object slides."""
    for first, end in runs(trace.speed > SLIDING).tolist():
        axis.axvspan(trace.t[max(first - 1, 0)], trace.t[end - 1], color=SHADE, linewidth=0)
