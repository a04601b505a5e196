"""What an experiment found, as a page: the paper's table beside ours, and how it failed."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from math import isfinite, nan
from pathlib import Path
from typing import Any, Final

import numpy as np

from flows.evaluation.page import Page, Section, Table
from flows.evaluation.sections import NONE, drawn, number
from flows.evaluation.written import told, written
from flows.experiment import figure
from flows.experiment.experiment import Found
from flows.experiment.lifting import Lifting
from flows.experiment.tapping import Tapping
from flows.options import counted

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
}  # success of 20 trials, %


def page(of: Found, command: str) -> Page:
    """The findings; `command` made them."""
    what = "Mallet tap" if of.kind == "tap" else "Object lift"
    text = (
        f"{tried(of)}, the same for all methods, from seed {of.seed} on, in the simulated "
        "scene; the paper's are of real objects. What counts as success, and what is assumed, is in "
        "docs/experiments.md."
    )
    shown = replace(successes(of), figure=drawn(lambda: figure.example(of)))
    return Page(f"{what}: {_best(of)}", text, [shown, *rest(of)], command)


def rest(of: Found) -> list[Section]:
    """Beyond success."""
    return [failures(of), costs(of) if of.kind == "lift" else alarms(of)]


def write(of: Found, folder: Path, command: str) -> list[Path]:
    """Write ``tap.html`` or ``lift.html``, ``.md``, ``.json`` and ``.svg`` into a folder; their paths.

    Raises:
        EndpointError: if they cannot be written.
    """
    return written(page(of, command), summary(of), folder, of.kind)


def text(of: Found) -> str:
    """What a person reads in a terminal."""
    return told([successes(of), *rest(of)])


def summary(of: Found) -> dict[str, Any]:
    """The same for a program; ``mean_success`` is that of the first method, in %; what is unknown is null."""
    methods = {
        method: {
            "mean_success": of.mean(method),
            "objects": {thing: of.success(method, thing) for thing in of.objects},
            "failures": {thing: _failures(of, method, [thing]) for thing in of.objects},
            **{name: known(value) for name, value in numbers(of, method).items()},
        }
        for method in of.methods
    }
    first = methods[of.methods[0]]
    return {
        "experiment": of.kind,
        "trials": of.trials,
        "seed": of.seed,
        "method": of.methods[0],
        "mean_success": first["mean_success"],
        "objects": first["objects"],
        "failures": _failures(of, of.methods[0], of.objects),
        "methods": methods,
    }


def successes(of: Found) -> Section:
    """The paper's table beside ours."""
    head = ["success, %", *(thing.replace("_", " ") for thing in of.objects), "mean"]
    rows = [
        [method, *(f"{of.success(method, thing):.0f}" for thing in of.objects), number(of.mean(method))]
        for method in of.methods
    ]
    paper = [PAPER[of.kind][thing] for thing in of.objects]
    rows.append(["paper, real objects", *map(str, paper), number(float(np.mean(paper)))])
    return Section(of.kind, _best(of), f"Of {tried(of)}.", [Table(head, rows)])


def failures(of: Found) -> Section:
    """How trials ended that did not go well."""
    rows = [
        [method, thing.replace("_", " "), *_told(_failures(of, method, [thing]))]
        for method in of.methods
        for thing in of.objects
        if of.success(method, thing) < 100  # noqa: PLR2004 - all
    ]
    first = of.methods[0]
    lost = Counter(_failures(of, first, of.objects)).most_common(1)
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
    rows = list[list[str]]()
    for method in of.methods:
        for name, outcomes in [*((t, of.outcomes[method, t]) for t in of.objects), ("all", of.all(method))]:
            found = [each for each in outcomes if isinstance(each, Lifting)]
            rows.append([method, name.replace("_", " "), *_row(found)])
    first = numbers(of, of.methods[0])
    force = first["force_ratio"]
    held = f"with {ratio(force)} times the least force" if isfinite(force) else "nothing"
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
    rows = list[list[str]]()
    for method in of.methods:
        for name, outcomes in [*((t, of.outcomes[method, t]) for t in of.objects), ("all", of.all(method))]:
            found = [each for each in outcomes if isinstance(each, Tapping)]
            rows.append([method, name.replace("_", " "), *_alarms(found)])
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


def _row(found: Sequence[Lifting]) -> list[str]:
    slides = [each.slide for each in found]
    return [
        number(median(slides)),
        number(float(np.quantile(slides, 0.9))),
        number(median([each.delay for each in found])).removesuffix(".0"),
        ratio(median([each.ratio for each in found])),
        ratio(median([each.peak for each in found])),
        f"{np.mean([each.false for each in found]):.1f}",
    ]


def _alarms(found: Sequence[Tapping]) -> list[str]:
    return [
        number(median([each.slide for each in found])),
        number(median([each.delay for each in found])).removesuffix(".0"),
        str(sum(each.drawn for each in found)),
        number(100 * float(np.mean([each.false_lift > 0 for each in found]))),
        number(100 * float(np.mean([each.false_tap > 0 for each in found]))),
        number(float(np.mean([each.false_hold for each in found])) * 60 / _HELD),
    ]


_HELD: Final = 2.1  # s, of each trial, of quiet


def numbers(of: Found, method: str) -> dict[str, float]:
    """Medians and shares of all trials of a method."""
    outcomes = of.all(method)
    lifts = [each for each in outcomes if isinstance(each, Lifting)]
    taps = [each for each in outcomes if isinstance(each, Tapping)]
    if lifts:
        return {
            "slide_mm": median([each.slide for each in lifts]),
            "slide_p90_mm": float(np.quantile([each.slide for each in lifts], 0.9)),
            "delay_ms": median([each.delay for each in lifts]),
            "force_ratio": median([each.ratio for each in lifts]),
            "peak_ratio": median([each.peak for each in lifts]),
        }
    return {
        "slide_mm": median([each.slide for each in taps]),
        "delay_ms": median([each.delay for each in taps]),
        "false_lift": 100 * float(np.mean([each.false_lift > 0 for each in taps])),
        "false_tap": 100 * float(np.mean([each.false_tap > 0 for each in taps])),
    }


def median(values: Sequence[float]) -> float:
    """Of those that are known; NaN if none is."""
    known = [each for each in values if each == each]  # noqa: PLR0124 - not NaN
    return float(np.median(known)) if known else nan


def ratio(value: float) -> str:
    """With two decimals.

    >>> ratio(1.656), ratio(nan)
    ('1.66', '-')
    """
    return f"{value:.2f}" if isfinite(value) else NONE


def known(value: float) -> float | None:
    """For a program: JSON has neither NaN nor infinity.

    >>> known(1.5), known(nan)
    (1.5, None)
    """
    return value if isfinite(value) else None


def tried(of: Found) -> str:
    """How many trials a share is of."""
    return f"{counted(of.trials, 'trial')} of each object"


def _failures(of: Found, method: str, things: Sequence[str]) -> dict[str, int]:
    return dict(
        Counter(each.ending for thing in things for each in of.outcomes[method, thing] if not each.success)
    )


def _told(failures: dict[str, int]) -> list[str]:
    return [", ".join(f"{count} {how}" for how, count in failures.items()) or NONE]


def _best(of: Found) -> str:
    first = of.methods[0]
    paper = float(np.mean([PAPER[of.kind][thing] for thing in of.objects]))
    verb = "feels the blow and the rest after it" if of.kind == "tap" else "holds"
    every = of.all(first)
    share = f"{sum(one.success for one in every)} of {counted(len(every), 'trial')}"
    return (
        f"{first} {verb} in {share}, {of.trials} of each object ({number(of.mean(first))} %); "
        f"the paper in {number(paper)} % of its own"
    )
