"""The tables of an experiment: success beside the paper's, failures, slide and force, false slips."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from math import isfinite
from typing import Final, TypeVar

import numpy as np

from flows.cli.options import counted
from flows.lab.experiments import trial_measures as measures
from flows.lab.experiments.experiment import Found, Outcome
from flows.lab.experiments.lifting import Lifting
from flows.lab.experiments.tapping import Tapping
from flows.lab.experiments.trial_measures import median, numbers, tried
from flows.report.page import NONE, Section, Table, number

Kept = TypeVar("Kept", bound=Outcome)

# success of 20 trials with real objects, %
PAPER: Final = {
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
QUIET: Final = 2.1  # s of each tap in which nothing is done to the object


def sections(of: Found) -> list[Section]:
    """Success, failures, and what an experiment of this kind costs."""
    return [successes(of), failures(of), costs(of) if of.kind == "lift" else alarms(of)]


def successes(of: Found) -> Section:
    """The paper's table beside ours."""
    head = ["success, %", *(thing.replace("_", " ") for thing in of.objects), "mean"]
    rows = [
        [method, *(f"{of.success(method, thing):.0f}" for thing in of.objects), number(of.mean(method))]
        for method in of.methods
    ]
    paper = [PAPER[of.kind][thing] for thing in of.objects]
    rows.append(["paper, real objects", *map(str, paper), number(float(np.mean(paper)))])
    return Section(of.kind, best(of), f"Of {tried(of)}.", [Table(head, rows)])


def failures(of: Found) -> Section:
    """How trials ended that did not go well."""
    rows = [
        [method, thing.replace("_", " "), _endings(measures.failures(of, method, [thing]))]
        for method in of.methods
        for thing in of.objects
        if of.success(method, thing) < 100  # noqa: PLR2004 - all
    ]
    first = of.methods[0]
    lost = Counter(measures.failures(of, first, of.objects)).most_common(1)
    every = of.all(first)
    failed = sum(not one.success for one in every)
    title = f"{first} fails in {failed} of {counted(len(every), 'trial')}"
    title += f", mostly by: {lost[0][0]}" if lost else ""
    return Section(
        "failures", title, "Trials that failed, by how.", [Table(["method", "object", "how"], rows)]
    )


def costs(of: Found) -> Section:
    """How far objects slid, and what it took to hold them."""
    head = ["method", "object", "slide mm", "p90", "delay ms", "force", "peak", "false slips"]
    rows = _by_object(of, Lifting, _cost_cells)
    first = numbers(of, of.methods[0])
    force = first["force_ratio"]
    held = f"with {number(force, 2)} times the least force" if isfinite(force) else "nothing"
    return Section(
        "costs",
        f"{of.methods[0]} lets slide by {number(first['slide_mm'])} mm and holds {held}",
        "Medians. Slide: from the lift on, in all trials. Delay: from the first sliding to the registered "
        "slip. Force: mean of the last second over the least that holds, where it is held; peak: the highest "
        "of the trial. False slips: registered before anything slid, per trial.",
        [Table(head, rows)],
    )


def alarms(of: Found) -> Section:
    """What is registered where nothing slips."""
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
    rows = _by_object(of, Tapping, _alarm_cells)
    first = numbers(of, of.methods[0])
    return Section(
        "alarms",
        f"{of.methods[0]} registers a false slip at {number(first['false_lift'])} % of firm lifts and "
        f"{number(first['false_tap'])} % of harmless blows",
        "The same grasp, lifted with that firm grip and hit so softly that nothing slides: shares of trials "
        "in which a slip is registered. Slide and delay, medians, are of the blow that moves it; where one "
        "did not move it by 0.5 mm, or moved it by more than 10, another was drawn.",
        [Table(head, rows)],
    )


def best(of: Found) -> str:
    """How often the first method succeeds, beside the paper; the title of the page."""
    first = of.methods[0]
    paper = float(np.mean([PAPER[of.kind][thing] for thing in of.objects]))
    verb = "feels the blow and the rest after it" if of.kind == "tap" else "holds"
    every = of.all(first)
    share = f"{sum(one.success for one in every)} of {counted(len(every), 'trial')}"
    return (
        f"{first} {verb} in {share}, {of.trials} of each object ({number(of.mean(first))} %); "
        f"the paper in {number(paper)} % of its own"
    )


def _by_object(of: Found, kind: type[Kept], cells: Callable[[Sequence[Kept]], list[str]]) -> list[list[str]]:
    """A row for each object and one for all, method by method; `cells` gives what follows their names."""
    return [
        [method, name.replace("_", " "), *cells([each for each in outcomes if isinstance(each, kind)])]
        for method in of.methods
        for name, outcomes in [
            *((thing, of.outcomes[method, thing]) for thing in of.objects),
            ("all", of.all(method)),
        ]
    ]


def _cost_cells(found: Sequence[Lifting]) -> list[str]:
    """Slide, its 0.9 quantile, delay, force, peak force, false slips."""
    slides = [each.slide for each in found]
    return [
        number(median(slides)),
        number(float(np.quantile(slides, 0.9))),
        number(median([each.delay for each in found])).removesuffix(".0"),
        number(median([each.ratio for each in found]), 2),
        number(median([each.peak for each in found]), 2),
        f"{np.mean([each.false for each in found]):.1f}",
    ]


def _alarm_cells(found: Sequence[Tapping]) -> list[str]:
    """Slide, delay, blows drawn, and how often a slip is registered where nothing slips."""
    return [
        number(median([each.slide for each in found])),
        number(median([each.delay for each in found])).removesuffix(".0"),
        str(sum(each.drawn for each in found)),
        number(100 * float(np.mean([each.false_lift > 0 for each in found]))),
        number(100 * float(np.mean([each.false_tap > 0 for each in found]))),
        number(float(np.mean([each.false_hold for each in found])) * 60 / QUIET),
    ]


def _endings(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {ending}" for ending, count in counts.items()) or NONE
