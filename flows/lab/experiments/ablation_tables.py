"""What an ablation found, as tables: against delay and rate, what breaks first, and why."""

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from connectors.sim.objects import OBJECTS
from flows.cli.options import counted
from flows.lab.experiments.experiment import Found
from flows.lab.experiments.lift_ablation import ENOUGH, GOOD, Ablation
from flows.lab.experiments.slide_budget import falling
from flows.lab.experiments.trial_measures import median, numbers, tried
from flows.report.page import Section, Table, number

NAME: Final = "lift-ablation"


def sections(of: Ablation) -> list[Section]:
    """Delay, rate, several at once, and the budgets."""
    return [delays(of), rates(of), hard(of), spent(of), slides(of)]


def delays(of: Ablation) -> Section:
    """Success against added delay."""
    named = {f"+{delay} ms": found for delay, found in of.delays.items()}
    return Section(NAME, "; ".join(title(of)), "The delay is added to the command's way.", _tables(of, named))


def rates(of: Ablation) -> Section:
    """Success against the rate of samples."""
    title = ". ".join(
        f"{method} holds {GOOD:.0f} % at {_listed(of, method) or 'no other rate'}" for method in of.methods
    )
    return Section(
        "rates",
        title,
        "As they come: the detector, which learnt at 100 Hz, takes each sample for 10 ms. Held: each reading "
        "is repeated until the next, so that it still gets 100 samples a second.",
        _tables(of, of.rates),
    )


def hard(of: Ablation) -> Section:
    """Success where several are hard at once."""
    worst = [(found.mean(method), name, method) for name, found in of.hard.items() for method in of.methods]
    mean, name, method = min(worst)
    return Section(
        "hard",
        f"{method} holds {number(mean)} % under {name}",
        "Half the friction; half the grip to begin with; a hand that goes up twice or four times as fast.",
        _tables(of, of.hard),
    )


def spent(of: Ablation) -> Section:
    """The delay at which each object should break, and the one at which it does."""
    head = ["object", "firm ms", "breaks", "predicted", "lost", "predicted"]
    tables = list[Table]()
    for method in of.methods:
        rows = [
            [
                thing.replace("_", " "),
                f"{1000 * median([each.firm for each in of.lifts(of.nominal, method, thing)]):.0f}",
                _whole(of.breaks(method, thing)),
                _whole(of.predicted(method, thing)),
                _whole(of.loses(method, thing)),
                _whole(of.predicted(method, thing, lost=True)),
            ]
            for thing in of.nominal.objects
        ]
        tables.append(Table(head, rows, caption=method))
    errors = [
        abs(of.breaks(method, thing) - of.predicted(method, thing))
        for method in of.methods
        for thing in of.nominal.objects
    ]
    known = [each for each in errors if math.isfinite(each)]
    told_by = f"to {np.median(known):.0f} ms (median)" if known else "nowhere"
    title = f"How soon the hand has climbed as far as an object may slide tells where it breaks {told_by}"
    if of.nominal.trials < ENOUGH:
        title = f"{tried(of.nominal)}: too few to tell how well the delay at which it breaks is predicted"
    return Section(
        "spent",
        title,
        "Added delay, ms, at which success falls below 90 %, and at which more than 10 % leave the fingers. "
        "Predicted: what one trial in ten has to spare, of the time until the hand has climbed as far as the "
        "object may slide (20 mm less what fingers and rubber give, or its reach), after the "
        "time that it takes without added delay to grip with what holds (firm, "
        "median).",
        tables,
    )


def slides(of: Ablation) -> Section:
    """What the objects leave a loop: where they stand on a table, and in the air."""
    head = [
        "object",
        "reach mm",
        "room mm",
        "grip",
        "table ms",
        "measured",
        "air ms",
        "measured",
        "reach, air",
    ]
    rows = list[list[str]]()
    for thing, found in of.budgets.items():
        share = median([each.share for each in found])
        reach = OBJECTS[thing].reach
        rows.append(
            [
                thing.replace("_", " "),
                f"{1000 * reach:.0f}",
                number(1000 * median([each.room for each in found])),
                f"{share:.2f}",
                *(
                    _whole(1000 * median([getattr(each, name) for each in found]))
                    for name in ("climbs", "climbed", "falls", "fell")
                ),
                _whole(1000 * median([falling(each.left, each.share) for each in found])),
            ]
        )
    return Section(
        "slides",
        "On the table all objects slide as fast as the hand climbs; in the air they fall",
        "Without control, medians. Reach: from the middle to where the fingers lose it. Room: what it may "
        "slide and still count as held. Grip: over the least that holds. Table: until it has slid its room, "
        "by the hand's way up. Air: the same, sqrt(2 way / (g (1 - grip / least))), where the grip slackens "
        "in the air. Reach, air: the same until it is lost.",
        [Table(head, rows)],
    )


def _tables(of: Ablation, conditions: Mapping[str, Found]) -> list[Table]:
    """One for each method: success by condition and object."""
    things = of.nominal.objects
    head = ["condition", *(thing.replace("_", " ") for thing in things), "mean", "lost", "slide mm", "force"]
    tables = list[Table]()
    for method in of.methods:
        rows = list[list[str]]()
        for name, found in conditions.items():
            costs = numbers(found, method)
            lifts = [each for thing in things for each in of.lifts(found, method, thing)]
            rows.append(
                [
                    name,
                    *(f"{found.success(method, thing):.0f}" for thing in things),
                    number(found.mean(method)),
                    number(100 * float(np.mean([each.lost for each in lifts]))),
                    number(costs["slide_mm"]),
                    number(costs["force_ratio"], 2),
                    number(float(np.mean([each.false for each in lifts]))),
                ]
            )
        tables.append(Table([*head, "false"], rows, caption=method))
    return tables


def title(of: Ablation) -> list[str]:
    """What breaks first, and what is lost first; for each method, where trials are enough to tell."""
    parts = list[str]()
    for method in of.methods:
        first = of.first(method)
        at = of.breaks(method, first)
        if math.isinf(at):
            parts.append(f"{method}: nothing breaks up to +{max(of.delays)} ms in {tried(of.nominal)}")
            continue
        if of.nominal.trials < ENOUGH:
            parts.append(f"{method}: {tried(of.nominal)}, too few to tell where it breaks")
            continue
        if not of.telling:
            parts.append(
                f"{method}: {_said(first)} breaks at +{at:.0f} ms in {counted(of.nominal.trials, 'trial')}"
            )
            continue
        part = f"{method}: {_said(first)} breaks first, at +{at:.0f} ms in {tried(of.nominal)}"
        soonest = min(of.loses(method, thing) for thing in of.nominal.objects)
        if math.isfinite(soonest):
            gone = [_said(thing) for thing in of.nominal.objects if of.loses(method, thing) == soonest]
            part += f", lost first: {' and '.join(gone)}, at +{soonest:.0f} ms"
        parts.append(part)
    return parts


def _said(thing: str) -> str:
    return f"the {thing.replace('_', ' ')}"


def _listed(of: Ablation, method: str) -> str:
    return "; ".join(name for name, found in of.rates.items() if found.mean(method) >= GOOD)


def _whole(value: float) -> str:
    return number(value, 0)
