"""Study: how often a rate of false alarms that `slipflow calibrate` states holds, and what it costs.

The sessions at hand are the population. Each draw calibrates on sessions drawn from it with replacement, as
if they had been recorded, and the setting is judged by its rate in the whole population, which is known
exactly; or the calibration has no session of one surface, and the setting is judged by its rate on that
surface. Where a draw has more static minutes than the population (20 and 60; the strokes have 11.5), sessions
repeat in it: it then contains fewer different sessions than a calibration of that length would.

The fixed order of settings was chosen on the simulated datasets wide-40 to wide-42; evaluate on others.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product, takewhile
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from flows.learn.alarms.alarm_calibration import PATH, Trials, calibrated
from flows.learn.alarms.alarm_limit import TooLittleDataError
from flows.learn.alarms.calibrated_model import UNITS, unseen_recordings
from flows.learn.scoring import probabilities
from flows.report.figures import CELLS, FAINT, Figure, grid, styled
from flows.report.report_page import Report, Section
from flows.report.table import Table, Value
from storage import load_detector
from storage.models import load_card, shipped

CONFIDENCE: Final = 0.95
RATES: Final = (0.5, 1.0, 2.0, 5.0)  # false alarms per static minute
CURVE: Final = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
MINUTES: Final = (5.0, 20.0, 60.0)  # static minutes of a calibration
Choice: TypeAlias = Callable[[Trials, float], int | None]  # place of the setting in `PATH`


@dataclass(frozen=True)
class Case:
    """Outcomes of a model on the sessions of some datasets."""

    name: str
    model: str
    trials: Trials
    surfaces: tuple[str, ...]  # of each session

    @property
    def minutes(self) -> float:
        """Static minutes of all sessions."""
        return float(self.trials.minutes.sum())


def read_case(name: str, model: str, datasets: Sequence[str]) -> Case:
    """Score every session that the model has not learned from."""
    card = load_card(shipped(model) or Path(model))
    recordings = [each for path in datasets for each in unseen_recordings(model, card, Path(path), print)]
    detector = load_detector(model)
    trials = Trials.of(recordings, [probabilities(detector, each) for each in recordings])
    return Case(name, model, trials, tuple(each.group or each.surface for each in recordings))


def by_calibration(trials: Trials, rate: float) -> int | None:
    """Return the setting that `slipflow calibrate` chooses; None if there is too little data."""
    try:
        return calibrated(trials, rate, CONFIDENCE).setting
    except TooLittleDataError:
        return None


def by_measured_rate(trials: Trials, rate: float) -> int | None:
    """Return the most sensitive setting up to which no measured rate is too high, without a confidence."""
    most = rate * trials.minutes.sum()
    accepted = list(takewhile(lambda setting: trials.alarms[setting].sum() <= most, range(len(PATH))))
    return accepted[-1] if accepted else None


def draw_trials(
    case: Case, places: Sequence[int], minutes: float, draws: int, *, by_surface: bool = False
) -> Iterator[Trials]:
    """Yield sessions of about this static time, drawn from some places with replacement."""
    random = np.random.default_rng(len(places))
    size = max(round(minutes / float(case.trials.minutes[[*places]].mean())), 2)
    for _ in range(draws):
        drawn: list[int] = random.choice(places, size).tolist()
        trials = case.trials.drawn(drawn)
        yield trials.pooled([case.surfaces[place] for place in drawn]) if by_surface else trials


def coverage(
    drawn: Sequence[Trials], judged: Trials, rate: float, choice: Choice
) -> tuple[float, float, float]:
    """Return how often the rate held (%), how often a setting was found (%), and the mean judged rate."""
    true = judged.alarms.sum(axis=1) / judged.minutes.sum()  # of each setting
    found = np.array([true[each] for one in drawn if (each := choice(one, rate)) is not None])
    if not len(found):
        return float("nan"), 0.0, float("nan")
    return 100 * float((found <= rate).mean()), 100 * len(found) / len(drawn), float(found.mean())


def table_alike(cases: Sequence[Case], draws: int) -> Table:
    """Return how often each rate held in the population, by static time of the calibration."""
    rows = list[list[Value]]()
    for case, minutes in product(cases, MINUTES):
        drawn = list(draw_trials(case, range(len(case.surfaces)), minutes, draws))
        for rate in RATES:
            found = coverage(drawn, case.trials, rate, by_calibration)
            naive = coverage(drawn, case.trials, rate, by_measured_rate)
            rows.append([case.name, minutes, rate, *found, naive[0], naive[2]])
    head = ["data", "static min", "rate, /min", "held %", "found %", "true rate"]
    return Table([*head, "no limit: held %", "no limit: true rate"], rows, decimals=_DECIMALS)


def table_surfaces(cases: Sequence[Case], draws: int) -> Table:
    """Return how often each rate held on a surface that the calibration had no session of."""
    rows = list[list[Value]]()
    for case in cases:
        for name in sorted(set(case.surfaces)):
            places = range(len(case.surfaces))
            others = [place for place in places if case.surfaces[place] != name]
            own = case.trials.drawn([place for place in places if case.surfaces[place] == name])
            drawn = list(draw_trials(case, others, MINUTES[1], draws))
            pooled = list(draw_trials(case, others, MINUTES[1], draws, by_surface=True))
            for rate in RATES:
                by_session = coverage(drawn, own, rate, by_calibration)
                by_surface = coverage(pooled, own, rate, by_calibration)
                rows.append([case.name, name, rate, *by_session, *by_surface])
        both = np.array([row[3:] for row in rows if row[0] == case.name], np.float64)
        rows.append([case.name, "mean", None, *np.nanmean(both, axis=0).tolist()])
    units = [[f"by {unit}: {text}" for text in ("held %", "found %", "true rate")] for unit in UNITS]
    return Table(["data", "surface", "rate, /min", *units[0], *units[1]], rows, decimals=_DECIMALS)


@dataclass(frozen=True)
class Cost:
    """Outcome of calibrated settings for a rate in the population."""

    rate: float
    true: float  # false alarms per static minute
    missed: float  # % of slips
    delay: float  # median, ms
    late: float  # 90th percentile of the delay, ms
    found: float  # % of draws with a setting


def cost(case: Case, rate: float, drawn: Sequence[Trials]) -> Cost:
    """Average the cost of a rate over draws."""
    chosen = [each for one in drawn if (each := by_calibration(one, rate)) is not None]
    found = [case.trials.metrics(each) for each in chosen]
    values = [[each.false_alarms_per_min, each.missed, each.onset_ms, each.late_ms] for each in found]
    true, missed, *delays = np.mean(values, axis=0).tolist() if values else [float("nan")] * 4
    delay, late = (float(np.round(each)) + 0.0 for each in delays)  # never -0
    return Cost(rate, true, missed, delay, late, 100 * len(found) / len(drawn))


@styled
def draw_curves(curves: dict[str, list[Cost]]) -> Figure:
    """Draw missed slips and delay against the rate."""
    figure, axes = grid(1, 2, (9, 3.4), sharex=True)
    for axis, key, text in zip(
        axes, ("missed", "delay"), ("missed slips, %", "median delay, ms"), strict=True
    ):
        for (name, curve), colour in zip(curves.items(), CELLS, strict=False):
            known = [each for each in curve if each.found]
            axis.plot(
                [each.rate for each in known],
                [getattr(each, key) for each in known],
                "o-",
                label=name,
                color=colour,
            )
        axis.set(xscale="log", xlabel="false alarms per static minute, wanted", ylabel=text)
        axis.set_xticks(CURVE, [f"{rate:g}" for rate in CURVE])
        axis.minorticks_off()
        axis.axhline(0, color=FAINT, linewidth=0.8, zorder=0)
        axis.grid(visible=True)
    axes[0].legend()
    return figure


def report(cases: Sequence[Case], draws: int, command: str) -> Report:
    """Run all draws."""
    like, other = table_alike(cases, draws), table_surfaces(cases, draws)
    curves = dict[str, list[Cost]]()
    for case in cases:
        drawn = list(draw_trials(case, range(len(case.surfaces)), MINUTES[-1], draws // 4))
        curves[case.name] = [cost(case, rate, drawn) for rate in CURVE]
    rows: list[list[Value]] = [
        [name, each.rate, each.true, each.missed, each.delay, each.late, each.found]
        for name, curve in curves.items()
        for each in curve
    ]
    head = "data", "rate, /min", "true rate", "missed %", "delay ms", "late ms", "found %"
    table = Table(head, rows, decimals=_DECIMALS)
    text = "; ".join(
        f"{case.name}: {case.model}, {len(case.surfaces)} sessions of {len(set(case.surfaces))} surfaces,"
        f" {case.minutes:.1f} static minutes"
        for case in cases
    )
    return Report(
        "A stated rate of false alarms: how often it holds, and its cost",
        f"{__doc__ or ''}\n{text}. Confidence {100 * CONFIDENCE:g} %, {draws} draws per row.".strip(),
        [
            Section("alike", _finding(like), _ALIKE, [like]),
            Section("surfaces", _surface_finding(other), _OTHER, [other]),
            Section("cost", _cost_finding(curves), _COST, [table], lambda: draw_curves(curves)),
        ],
        command,
    )


_ALIKE: Final = (
    "Held: draws whose setting has at most the wanted rate in the population, % of those in which a setting"
    " was found. Found: draws with enough static time. True rate: mean over draws, false alarms per static"
    " minute. No limit: the most sensitive setting up to which all measured rates are at most the wanted one."
)
_OTHER: Final = (
    f"Calibrated on {MINUTES[1]:g} static minutes of the other surfaces, with sessions or surfaces as the"
    " units (`--by`). By session no confidence is stated for this, because the sessions are not like those of"
    " the calibration; by surface it is stated for surfaces at random, which is the mean over surfaces."
)
_COST: Final = (
    f"Settings calibrated by session on {MINUTES[-1]:g} static minutes; slips by the recording's label."
    " Late: 90th percentile of the delay."
)
_DECIMALS: Final = {
    "static min": 0,
    "rate, /min": None,
    "true rate": 2,
    "by session: true rate": 2,
    "by surface: true rate": 2,
    "no limit: true rate": 2,
    "delay ms": 0,
    "late ms": 0,
}


def _finding(table: Table) -> str:
    lowest = dict[str, float]()
    for row in table.rows:
        name, held = str(row[0]), float(row[3] or 0)
        if np.isfinite(held):
            lowest[name] = min(held, lowest.get(name, 100.0))
    text = ", ".join(f"{name} {held:.0f}" for name, held in lowest.items())
    return f"On data like that of the calibration the rate held in {text} % of the draws or more"


def _surface_finding(table: Table) -> str:
    means = [row for row in table.rows if row[1] == "mean"]
    held = [", ".join(f"{row[0]} {row[column]:.0f}" for row in means) for column in (3, 6)]
    return (
        f"On surfaces that the calibration lacked the rate held in {held[0]} % of the draws by session,"
        f" in {held[1]} % by surface"
    )


def _cost_finding(curves: dict[str, list[Cost]]) -> str:
    at = {name: next(each for each in curve if each.rate == 1) for name, curve in curves.items()}
    text = ", ".join(f"{name} {each.missed:.1f} % and {each.delay:.0f} ms" for name, each in at.items())
    return f"One false alarm per minute costs missed slips and delay: {text}"


def main() -> None:
    """Measure and write the page."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--case", action="append", nargs="+", required=True, metavar="NAME MODEL DATASET")
    options.add_argument("--draws", type=int, default=200)
    options.add_argument("--out", type=Path, default=Path("alarms"))
    given = options.parse_args()
    cases = [read_case(name, model, datasets) for name, model, *datasets in given.case]
    shown = " ".join(
        f"--case {' '.join((name, Path(model).name, *(Path(each).name for each in datasets)))}"
        for name, model, *datasets in given.case
    )
    command = f"python -m tests.benchmarks.bench_alarms {shown} --draws {given.draws}"
    found = report(cases, given.draws, command)
    found.write(given.out, "alarms")
    print(found.terminal())


if __name__ == "__main__":
    main()
