"""Report of the limits of the lift: against delay and rate, which object breaks first, and why."""

import math
from typing import Any, Final

import numpy as np

from connectors.sim.objects import OBJECTS
from flows.lab.experiments.lift_ablation import ENOUGH, GOOD, Ablation, fall_time
from flows.lab.experiments.lift_trial import LIFT, ROOM
from flows.lab.experiments.study import Method, median
from flows.lab.experiments.study_report import condition_table, title
from flows.report.figures import CELLS, FAINT, INK, Axes, Figure, grid, styled
from flows.report.report_page import Report, Section
from flows.report.table import Table, Value, show

NAME: Final = "lift-ablation"
COLOURS: Final = dict(zip(OBJECTS, CELLS, strict=True))  # by object
MARKERS: Final = dict(zip(OBJECTS, "soD^vP", strict=True))


def ablation_report(found: Ablation, command: str) -> Report:
    """Report the limits of the lift that `command` measured."""
    trials = found.nominal.trials
    text = (
        f"{trials}, the same under each condition. Success, %, by object; lost: fell out of the gripper, %; "
        "false: slips registered before anything slid, per trial. Slide and force are medians; force is "
        "relative to the least that holds, in trials that hold."
    )
    sections = [_delays(found), _rates(found), _hard(found), _limits(found), _budgets(found)]
    facts: dict[str, Any] = {
        "experiment": NAME,
        "trials": trials.count,
        "seed": trials.seed,
        "breaks_first": {
            str(method): found.first_to_break(method) if found.ranks else None
            for method in found.nominal.methods
        },
    }
    return Report("Limits of the lift", text, sections, command, facts)


def _delays(found: Ablation) -> Section:
    named = {f"+{delay} ms": results for delay, results in found.delays.items()}
    tables = [condition_table(named, method, str(method)) for method in found.nominal.methods]
    findings = [_finding(found, method) for method in found.nominal.methods]
    text = "The delay is added between a command and the gripper."
    return Section(NAME, "; ".join(findings), text, tables, lambda: figure(found, "\n".join(findings)))


def _rates(found: Ablation) -> Section:
    def good(method: Method) -> str:
        names = [name for name, results in found.rates.items() if results.mean(method) >= GOOD]
        return "; ".join(names) or "no other rate"

    methods = found.nominal.methods
    return Section(
        "rates",
        ". ".join(f"{method} holds {GOOD:.0f} % at {good(method)}" for method in methods),
        "The detectors were trained at 100 Hz and take each sample for 10 ms. Repeated: each reading is "
        "repeated until the next one, so that the detector still gets 100 samples per second.",
        [condition_table(found.rates, method, str(method)) for method in methods],
    )


def _hard(found: Ablation) -> Section:
    methods = found.nominal.methods
    mean, name, method = min(
        (results.mean(method), name, str(method))
        for name, results in found.hard.items()
        for method in methods
    )
    return Section(
        "hard",
        f"{method} holds {show(mean)} % under {name}",
        "Half the friction; half the initial force; a lift at two or four times the speed.",
        [condition_table(found.hard, method, str(method)) for method in methods],
    )


def _limits(found: Ablation) -> Section:
    """Return the section about the predicted and the measured delay at which each object breaks."""
    trials, methods = found.nominal.trials, found.nominal.methods
    head = ["object", "firm ms", "breaks ms", "predicted ms", "lost ms", "predicted loss ms"]
    tables = [
        Table(head, [_limit_row(found, method, name) for name in trials.objects], str(method), _whole(head))
        for method in methods
    ]
    errors = [
        abs(found.breaking_delay(method, name) - found.predicted_delay(method, name))
        for method in methods
        for name in trials.objects
    ]
    known = [error for error in errors if math.isfinite(error)]
    finding = "No object breaks within the delays tried"
    if trials.count < ENOUGH:
        finding = f"{trials}: too few to judge the prediction of the delay at which objects break"
    elif known:
        error = f"{np.median(known):.0f} ms (median)"
        finding = f"The climb of the gripper predicts the delay at which objects break to {error}"
    return Section(
        "limits",
        finding,
        "Added delay at which success falls below 90 %, and at which more than 10 % of the objects fall out "
        "of the gripper. Predicted: the time that one trial in ten has to spare until the gripper has "
        "climbed as far as the object may slide (20 mm less the compliance of the fingers, or its reach), "
        "after the time until the grip is firm enough without added delay (firm, median).",
        tables,
    )


def _limit_row(found: Ablation, method: Method, name: str) -> list[Value]:
    return [
        title(name),
        1000 * median([outcome.firm for outcome in found.nominal.of(method, name)]),
        found.breaking_delay(method, name),
        found.predicted_delay(method, name),
        found.loss_delay(method, name),
        found.predicted_delay(method, name, lost=True),
    ]


def _budgets(found: Ablation) -> Section:
    """Return the section about the time that the objects allow, on the table and in the air."""
    times = ("table", "table_measured", "air", "air_measured")
    rows: list[list[Value]] = [
        [
            title(name),
            1000 * OBJECTS[name].reach,
            1000 * median([each.room for each in budgets]),
            median([each.share for each in budgets]),
            *(1000 * median([getattr(each, time) for each in budgets]) for time in times),
            1000 * median([fall_time(each.reach, each.share) for each in budgets]),
        ]
        for name, budgets in found.budgets.items()
    ]
    whole = ["reach mm", "table ms", "table measured ms", "air ms", "air measured ms", "air until lost ms"]
    head = ["object", "reach mm", "room mm", "grip", *whole[1:]]
    return Section(
        "budgets",
        "On the table all objects slide as fast as the gripper climbs; in the air they fall",
        "Without control, medians. Reach: from the object's centre to where it falls out of the gripper. "
        "Room: slide up to which it counts as held. Grip: over the least that holds. Table: time to slide "
        "by the room, from the motion of the arm. Air: the same by sqrt(2 room / (g (1 - grip / least))), if "
        "the force drops in the air; until lost: for the reach.",
        [Table(head, rows, decimals={**_whole(whole), "grip": 2})],
    )


def _whole(columns: list[str]) -> dict[str, int]:
    return dict.fromkeys(columns, 0)


def _finding(found: Ablation, method: Method) -> str:
    """Return the sentence about the object that breaks first and the one that is lost first."""
    trials, first = found.nominal.trials, found.first_to_break(method)
    at = found.breaking_delay(method, first)
    if math.isinf(at):
        return f"{method}: nothing breaks up to +{max(found.delays)} ms in {trials}"
    if trials.count < ENOUGH:
        return f"{method}: {trials}, too few to find where it breaks"
    if not found.ranks:
        return f"{method}: the {title(first)} breaks at +{at:.0f} ms in {trials.count} trials"
    finding = f"{method}: the {title(first)} breaks first, at +{at:.0f} ms in {trials}"
    soonest = min(found.loss_delay(method, name) for name in trials.objects)
    if math.isfinite(soonest):
        lost = [f"the {title(name)}" for name in trials.objects if found.loss_delay(method, name) == soonest]
        finding += f", lost first: {' and '.join(lost)}, at +{soonest:.0f} ms"
    return finding


@styled
def figure(found: Ablation, heading: str) -> Figure:
    """Draw success and slide against added delay: a column for each method, a line for each object."""
    from matplotlib.lines import Line2D  # noqa: PLC0415 - an extra, and slow to import

    methods = found.nominal.methods
    columns = len(methods)
    drawing, axes = grid(2, columns, (4.6 * columns + 0.4, 6.4), sharex=True)
    for column, method in enumerate(methods):
        above, below = axes[column], axes[columns + column]
        for name in found.nominal.trials.objects:
            _plot_object(found, method, name, above, below)
        _plot_climb(found, method, below)
        above.axhline(GOOD, color=FAINT, linestyle="--", linewidth=0.8, zorder=0)
        above.set(ylim=(-4, 112), title=f"{method}: success, %")
        below.set(ylim=(0, 52), title="median slide, mm", xlabel="added delay, ms")
        for axis in (above, below):
            axis.yaxis.grid(visible=True)
    handles, names = axes[0].get_legend_handles_labels()
    drawing.legend(
        [*handles, Line2D([], [], color=INK, marker="v", linestyle="none")],
        [*names, "predicted limit"],
        loc="outside lower center",
        ncols=7,
    )
    drawing.suptitle(heading, x=0.01, ha="left", fontsize=10, fontweight="bold")
    return drawing


def _plot_object(found: Ablation, method: Method, name: str, above: Axes, below: Axes) -> None:
    """Plot an object's success and slide, and mark its predicted limit."""
    delays = list(found.delays)
    style = {"color": COLOURS[name], "marker": MARKERS[name], "markersize": 3.5}
    successes = [results.success(method, name) for results in found.delays.values()]
    above.plot(delays, successes, label=title(name), **style)
    slides = [
        np.median([outcome.slide for outcome in results.of(method, name)])
        for results in found.delays.values()
    ]
    below.plot(delays, slides, **style)
    limit = found.predicted_delay(method, name)
    if math.isfinite(limit):
        above.plot(limit, 106, marker="v", color=COLOURS[name], markersize=6, linestyle="none", clip_on=False)


def _plot_climb(found: Ablation, method: Method, below: Axes) -> None:
    """Plot how far the gripper has climbed when the grip becomes firm, and the slide that counts as held."""
    firm = median([outcome.firm for outcome in found.nominal.of(method) if outcome.firm > 0])  # s
    delays = np.linspace(0, max(found.delays), 200)
    climbed = 1000 * LIFT.climbed(LIFT.instant + firm + delays / 1000)
    below.plot(delays, climbed, color=INK, linestyle=":", linewidth=1, zorder=0)
    note = "dotted: climb of the gripper until the grip is firm"
    below.text(0.98, 0.05, note, transform=below.transAxes, ha="right", fontsize=7)
    below.axhline(1000 * ROOM, color=FAINT, linestyle="--", linewidth=0.8, zorder=0)
    below.annotate("counts as held", (0, 1000 * ROOM), (0, 2), textcoords="offset points", fontsize=7)
