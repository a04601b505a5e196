"""Report of a benchmark: for each dataset an overview, events, each fold, and what inflates a score."""

from dataclasses import asdict
from math import isfinite
from typing import Any, Final

from flows.learn.benchmark import benchmark_figures as drawn
from flows.learn.benchmark.benchmark_study import Benchmark, DatasetResult, EntrantResult
from flows.learn.benchmark.entrants import DEFAULT, MEANING, MINUTES
from flows.learn.evaluation.figures_table import FIGURES_DECIMALS, FIGURES_HEAD, figures_cells
from flows.learn.evaluation.intervals import DRAWS
from flows.learn.evaluation.sample_metrics import percent
from flows.learn.evaluation.target_table import event_text
from flows.learn.leaks.leak_section import leak_section
from flows.report.report_page import Report, Section
from flows.report.table import Table, Value, counted, show

_ERROR: Final = "calibration error %", "calibration error % 95 %"
_SPLITS: Final = {"group": "surfaces or objects", "recording": "recordings"}


def benchmark_report(of: Benchmark, command: str) -> Report:
    """Return the report of a benchmark that `command` made."""
    text = (
        "Detectors on real recordings. Each surface, object or recording is judged by detectors that never "
        "saw it; windows and recordings are never split. "
        + " ".join(f"{regime}: {MEANING[regime].format(parts='folds')}." for regime in of.regimes)
        + " Far: balanced accuracy 100 ms or more from any change of the label, which may lag the touch."
        " Calibration error: mean distance between probability and share of slip in ten bins."
        f" Intervals are 95 % over recordings ({DRAWS} draws with replacement). Decisions are at "
        "probability 0.5; events follow the debounce of the model card, or one tuned on recordings of the "
        "other folds, which the detector was not fitted to where enough have slip."
        + "".join(
            f" Leak in {each.data.name}: {leak.finding}." for each in of.datasets for leak in each.leaks
        )
    )
    title = "; ".join(_headline(each) for each in of.datasets)
    sections = [section for each in of.datasets for section in _sections(each)]
    return Report(f"Benchmark: {title}", text, sections, command, _facts(of))


def _sections(of: DatasetResult) -> list[Section]:
    leaks = leak_section(of.leaks, of.unchecked)
    name = of.data.name
    return [
        _overview(of),
        _events(of),
        _folds(of),
        Section(f"{name}-leaks", f"{name}: {leaks.finding}", leaks.text, leaks.tables),
    ]


def _overview(of: DatasetResult) -> Section:
    data = of.data
    rows: list[list[Value]] = [
        [each.entrant.regime, each.entrant.name, *_cells(each)[:6], *_calibration(each), _note(each)]
        for each in of.results
    ]
    lacking = "".join(f" Missing: {name}, {reason}." for name, reason in of.missing.items())
    notes = "".join(f" {note}." for note in data.notes)
    folds = ", ".join(fold.name for fold in data.folds)
    with_slip = sum(bool(each.slip.any()) for each in data.recordings)
    few = f" (only in {with_slip} recordings)" if with_slip < len(data.recordings) else ""
    return Section(
        data.name,
        _headline(of),
        f"{counted(len(data.recordings), 'recording')} of {data.minutes:.1f} minutes, "
        f"{data.slip:.0f} % slip{few}, in {counted(len(data.folds), 'fold')} by {data.by}: {folds}."
        f"{notes}{lacking}",
        [Table(["regime", "detector", *FIGURES_HEAD[:6], *_ERROR, "note"], rows, decimals=FIGURES_DECIMALS)],
        lambda: drawn.overview(of),
    )


def _events(of: DatasetResult) -> Section:
    rows: list[list[Value]] = [
        [each.entrant.regime, each.entrant.name, *_cells(each)[6:]] for each in of.results
    ]
    first = of.best("in-domain") or of.best("zero-shot") or next(iter(of.results), None)
    finding = f"{of.data.name}: no detector was evaluated"
    if first:
        found = first.figures
        finding = f"{of.data.name}: {first.entrant.title} " + event_text(
            found.false_alarms_per_min.value, found.missed.value, found.delay.value
        )
    return Section(
        f"{of.data.name}-events",
        finding,
        "Events: reported slips per minute of recording. False: events without a slip, per static minute. "
        "Missed: slips without an event from 50 ms before to 150 ms after. Delay: from the start of the "
        "labelled slip; the label itself may lag the touch.",
        [Table(["regime", "detector", *FIGURES_HEAD[6:]], rows, decimals=FIGURES_DECIMALS)],
        lambda: drawn.events(of),
    )


def _folds(of: DatasetResult) -> Section:
    names = [fold.name for fold in of.data.folds]
    rows: list[list[Value]] = [
        [each.entrant.regime, each.entrant.name, *(each.by_fold[name] for name in names), _mean(each)]
        for each in of.results
    ]
    best = of.best("in-domain") or of.best("zero-shot")
    finding = f"{of.data.name}: balanced accuracy on each {of.data.by}"
    if best:
        known = {name: value for name, value in best.by_fold.items() if isfinite(value)}
        hardest = min(known, key=known.__getitem__, default="")
        if hardest:
            finding = (
                f"{of.data.name}: {hardest} is the hardest for {best.entrant.title}, {known[hardest]:.1f} %"
            )
    return Section(
        f"{of.data.name}-folds",
        finding,
        f"Balanced accuracy, %, on each {of.data.by} held out, and their mean; a dash where slip or static "
        "is missing.",
        [Table(["regime", "detector", *names, "mean"], rows), *_gap(of)],
        terminal=False,
    )


def _gap(of: DatasetResult) -> list[Table]:
    """Return the share of the gap to the in-domain default detector that few-shot detectors close."""
    found = {(each.entrant.regime, each.entrant.name): each.by_fold for each in of.results}
    if (high := found.get(("in-domain", DEFAULT))) is None:
        return []
    names = [fold.name for fold in of.data.folds]
    rows: list[list[Value]] = [
        [regime, name, *(_closed(own[fold], low[fold], high[fold]) for fold in names)]
        for (regime, name), own in found.items()
        if regime == "few-shot" and (low := found.get(("zero-shot", name)))
    ]
    if not any(isinstance(value, float) and isfinite(value) for row in rows for value in row):
        return []
    caption = f"gap between zero-shot and in-domain {DEFAULT} that is closed, %"
    return [Table(["regime", "detector", *names], rows, caption, dict.fromkeys(names, 0))]


def _closed(own: float, low: float, high: float) -> float:
    """Return the share of a gap that is closed, %; NaN if there is none."""
    return percent(own - low, high - low) if high > low else float("nan")


def _headline(of: DatasetResult) -> str:
    parts = [
        f"{regime} {best.entrant.name} {show(best.figures.balanced.value)}"
        + (f" ({best.figures.balanced.interval()})" if best.figures.balanced.interval() else "")
        for regime in MEANING
        if (best := of.best(regime))
    ]
    return (
        f"{of.data.name}: balanced accuracy {', '.join(parts)} %" if parts else f"{of.data.name}: no result"
    )


def _cells(of: EntrantResult) -> list[Value]:
    return figures_cells(of.figures)


def _calibration(of: EntrantResult) -> list[Value]:
    return [of.figures.calibration.value, of.figures.calibration.interval() or None]


def _note(of: EntrantResult) -> str:
    """Return the leaks, or the origin and what did not happen."""
    leaks = dict.fromkeys("leak: " + leak.kind for leak in of.leaks)
    return "; ".join([*(leaks or [of.entrant.origin]), *of.notes])


def _mean(of: EntrantResult) -> float:
    known = [value for value in of.by_fold.values() if isfinite(value)]
    return sum(known) / len(known) if known else float("nan")


def _facts(of: Benchmark) -> dict[str, Any]:
    return {
        "regimes": {regime: MEANING[regime].format(parts="folds") for regime in of.regimes},
        "few_shot_minutes": MINUTES,
        "seed": of.course.seed,
        "steps": of.course.recipe.steps,
        "datasets": {
            each.data.name: {
                "recordings": len(each.data.recordings),
                "minutes": round(each.data.minutes, 3),
                "slip_percent": round(each.data.slip, 3),
                "split_by": each.data.by,
                "folds": {
                    fold.name: [each.data.recordings[place].name for place in fold.test]
                    for fold in each.data.folds
                },
                "notes": list(each.data.notes),
                "missing": dict(each.missing),
                "leaks": [leak.json() for leak in each.leaks],
                "results": [_result_facts(result) for result in each.results],
            }
            for each in of.datasets
        },
    }


def _result_facts(of: EntrantResult) -> dict[str, Any]:
    """Return the figures of an entrant with their intervals as numbers; unknown ones are null."""
    estimates = {
        name: {key: _known(value) for key, value in estimate.items()}
        for name, estimate in asdict(of.figures).items()
    }
    by_fold = {name: _known(value) for name, value in of.by_fold.items()}
    about = {"regime": of.entrant.regime, "detector": of.entrant.name, "draws": of.entrant.draws}
    return {**about, "notes": list(of.notes), **estimates, "balanced_by_fold": by_fold}


def _known(value: float) -> float | None:
    return float(f"{value:.6g}") if isfinite(value) else None
