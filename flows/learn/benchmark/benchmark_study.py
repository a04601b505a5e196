"""`slipflow benchmark`: every detector on real surfaces, objects or recordings that it never saw."""

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import product
from math import isclose
from pathlib import Path
from typing import TypeAlias

import numpy as np

from flows.learn.benchmark.entrants import (
    MAJORITY,
    MINUTES,
    REGIMES,
    Course,
    Entrant,
    Regime,
    entrants,
)
from flows.learn.benchmark.folds import BenchmarkData, Fold, load_folds
from flows.learn.evaluation.event_metrics import DECISION
from flows.learn.evaluation.intervals import Figures, Judged, figures
from flows.learn.evaluation.methods import SHIPPED, trained_methods
from flows.learn.evaluation.sample_metrics import Confusion
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.leaks.leak import Leak, card_leaks, constant_leaks, lists_recordings
from flows.learn.provenance import dataset_digest
from flows.learn.scoring import probabilities
from flows.run.executor import one_thread, process_map
from operators.checks import check_choice
from operators.errors import SlipflowError
from operators.extras import require_extra
from operators.fingertip import RATE_TOLERANCE

Log: TypeAlias = Callable[[str], object]
Progress: TypeAlias = Callable[[int, int, str], object]  # parts done, all parts, part that was done


@dataclass(frozen=True, slots=True, eq=False)
class EntrantResult:
    """Results of an entrant on a dataset."""

    entrant: Entrant
    figures: Figures
    by_fold: Mapping[str, float]  # balanced accuracy, %, on the recordings of each fold
    leaks: tuple[Leak, ...]
    notes: tuple[str, ...] = ()  # what did not happen, such as "kept: too short"


@dataclass(frozen=True, slots=True, eq=False)
class DatasetResult:
    """Results of all entrants on a dataset."""

    data: BenchmarkData
    results: tuple[EntrantResult, ...]  # by regime, the best balanced accuracy first
    missing: Mapping[str, str]  # reasons by regime and name
    unchecked: tuple[str, ...]  # detectors whose card does not list the recordings of their training

    def best(self, regime: Regime) -> EntrantResult | None:
        """Return the result with the best balanced accuracy in a regime that has no leak of its own."""
        found = [each for each in self.results if each.entrant.regime == regime and not each.leaks]
        return found[0] if found else None

    @property
    def leaks(self) -> tuple[Leak, ...]:
        """All leaks."""
        return (*self.data.leaks, *(leak for each in self.results for leak in each.leaks))


@dataclass(frozen=True, slots=True, eq=False)
class Benchmark:
    """Results on all datasets."""

    datasets: tuple[DatasetResult, ...]
    regimes: tuple[Regime, ...]
    course: Course


def benchmark(
    datasets: Mapping[str, Path],
    course: Course,
    *,
    regimes: Collection[str] = REGIMES,
    models: Sequence[Path] = (),
    names: Collection[str] = (),
    groups: Collection[str] = (),
    jobs: int | None = None,
    log: Log = lambda _: None,
    progress: Progress = lambda _done, _all, _part: None,
) -> Benchmark:
    """Evaluate detectors on datasets.

    A detector that was made for another rate is judged on samples converted to its rate.

    Args:
        datasets: Folders by name.
        course: Settings of the fits.
        regimes: Some of `REGIMES`: what detectors may learn from.
        models: Files of weights to evaluate zero-shot as well.
        names: Only these detectors, and those of `models`; empty: all.
        groups: Only recordings of these surfaces or objects; empty: all.
        jobs: Number of processes; None: one per core.
        log: Receives leaks, and reasons for what is missing.
        progress: Called after each fit.

    Raises:
        InputError: if the train extra is missing, or a dataset, detector or model cannot be used.
        ParameterError: if a regime or name is unknown, or `jobs` is below 1.
        SlipflowError: if a process died.
    """
    require_extra("train", "benchmark")
    for regime in regimes:
        check_choice("benchmark", "regime", regime, REGIMES)
    methods = trained_methods(models)
    given = [each.name for each in methods if each.origin != SHIPPED] if names else []
    every = entrants(methods, regimes)
    for name in names:
        check_choice("benchmark", "method", name, sorted({each.name for each in every}))
    chosen = [each for each in every if not names or each.name in {*names, *given}]
    loaded = {name: _at_rates(path, name, groups, chosen) for name, path in datasets.items()}
    units = {name: _units(data, chosen, course) for name, data in loaded.items()}
    costs = _Costs(sum(unit.entrant.cost for each in units.values() for unit in each), progress)
    results = list[DatasetResult]()
    for name, data in loaded.items():
        found = _run(units[name], jobs, costs)
        result = _result(data, chosen, found, dataset_digest(datasets[name]))
        results.append(result)
        for leak in result.leaks:
            log(f"{name}: leak: {leak.finding}")
        for entrant, reason in result.missing.items():
            log(f"{name}: no {entrant}: {reason}")
    return Benchmark(tuple(results), tuple(each for each in REGIMES if each in regimes), course)


@dataclass(frozen=True, slots=True, eq=False)
class _Loaded:
    """Dataset at the rates of its entrants."""

    own: BenchmarkData  # at its own rate, 100 Hz at least
    by_entrant: Mapping[str, BenchmarkData]  # by title


def _at_rates(path: Path, name: str, groups: Collection[str], chosen: Sequence[Entrant]) -> _Loaded:
    """Read a dataset once for each rate at which entrants are judged."""
    own = load_folds(path, name, groups=groups)
    found, by_entrant = [own], dict[str, BenchmarkData]()
    for entrant in chosen:
        rate = entrant.rate(own.fingertip)
        near = (each for each in found if isclose(each.fingertip.rate, rate, rel_tol=RATE_TOLERANCE))
        if (data := next(near, None)) is None:
            found.append(data := load_folds(path, name, rate, groups))
        by_entrant[entrant.title] = data
    notes = list(own.notes)
    for data in found[1:]:
        names = dict.fromkeys(each.name for each in chosen if by_entrant[each.title] is data)
        notes.append(f"{', '.join(names)}: at {data.fingertip.rate:g} Hz, converted by Resample")
    return _Loaded(replace(own, notes=tuple(notes)), by_entrant)


@dataclass(frozen=True, slots=True)
class _Unit:
    """One fit, and the recordings to judge."""

    entrant: Entrant
    fold: Fold
    draw: int
    test: Sequence[LabelledRecording]
    course: Course


def _units(loaded: _Loaded, chosen: Sequence[Entrant], course: Course) -> list[_Unit]:
    units = list[_Unit]()
    for entrant, place in product(chosen, range(len(loaded.own.folds))):
        data = loaded.by_entrant[entrant.title]
        fold = data.folds[place]
        for draw in range(entrant.draws):
            test = [data.recordings[place] for place in fold.test]
            units.append(_Unit(entrant, fold, draw, test, course))
    return units


@dataclass(frozen=True, slots=True)
class _Answers:
    """Answers on each recording, and what the fit did not do."""

    judged: Sequence[Judged]
    note: str


_Found: TypeAlias = _Answers | str  # the reason why there are none


@dataclass
class _Costs:
    """Progress by the relative time of each fit."""

    all: float
    progress: Progress
    done: float = 0.0

    def add(self, unit: _Unit) -> None:
        """Report that a unit is done."""
        self.done += unit.entrant.cost
        part = f"{unit.entrant.title}, {unit.fold.name}"
        self.progress(round(self.done), round(self.all), part)


def _run(units: Sequence[_Unit], jobs: int | None, costs: _Costs) -> list[tuple[_Unit, _Found]]:
    """Fit and judge, the longest first."""
    ordered = sorted(units, key=lambda unit: -unit.entrant.cost)
    found = list[tuple[_Unit, _Found]]()
    with closing(process_map(_judge, ordered, jobs)) as each:
        for unit, result in zip(ordered, each, strict=True):
            found.append((unit, result))
            costs.add(unit)
    return found


@one_thread()
def _judge(unit: _Unit) -> _Found:
    try:
        fit = unit.entrant.fit(unit.fold, unit.course, unit.draw)
        judged = [Judged.of(each, probabilities(fit.detector, each), fit.debounce) for each in unit.test]
        return _Answers(judged, fit.note)
    except SlipflowError as error:  # such as a detector for another fingertip
        return str(error)


def _result(
    loaded: _Loaded,
    chosen: Sequence[Entrant],
    found: Sequence[tuple[_Unit, _Found]],
    digest: str,
) -> DatasetResult:
    """Return the results on a dataset, by regime, the best balanced accuracy first."""
    results, missing = list[EntrantResult](), dict[str, str]()
    for entrant in chosen:
        data = loaded.by_entrant[entrant.title]
        judged: list[list[Judged]] = [[] for _ in data.recordings]
        kept, fits = Counter[str](), 0
        for unit, answers in found:
            if unit.entrant is not entrant:
                continue
            if isinstance(answers, str):
                missing[entrant.title] = answers
                continue
            kept[answers.note], fits = kept[answers.note] + 1, fits + 1
            for place, each in zip(unit.fold.test, answers.judged, strict=True):
                judged[place].append(each)
        if entrant.title not in missing:
            notes = [f"{note} ({count} of {fits} fits)" for note, count in kept.items() if note]
            result = _entrant_result(data, entrant, judged, digest)
            results.append(replace(result, notes=(*_few_minutes(data, entrant), *notes)))
    order = {regime: place for place, regime in enumerate(REGIMES)}
    results.sort(key=lambda each: (order[each.entrant.regime], -each.figures.balanced.value))
    unchecked = [
        each.name
        for each in chosen
        if each.method and each.method.card and not lists_recordings(each.method.card)
    ]
    return DatasetResult(loaded.own, tuple(results), missing, tuple(unchecked))


def _entrant_result(
    data: BenchmarkData, entrant: Entrant, judged: Sequence[Sequence[Judged]], digest: str
) -> EntrantResult:
    total = _confusion([each for own in judged for each in own])
    leaks = list[Leak]()
    if entrant.name != MAJORITY:  # is constant by definition
        leaks += constant_leaks(entrant.title, total.counts)
    if entrant.method:
        leaks += card_leaks(entrant.title, entrant.method.card, data.recordings, digest)
    by_fold = {
        fold.name: _confusion([each for place in fold.test for each in judged[place]]).balanced
        for fold in data.folds
    }
    return EntrantResult(entrant, figures(judged), by_fold, tuple(leaks))


def _few_minutes(data: BenchmarkData, entrant: Entrant) -> list[str]:
    """Return a note if some fold has fewer labelled minutes than the few-shot regime takes."""
    sampling = data.recordings[0].sampling
    least = min(sampling.minutes(sum(map(len, fold.train))) for fold in data.folds)
    short = entrant.regime == "few-shot" and least < MINUTES
    return [f"{least:.1f} min available"] if short else []


def _confusion(judged: Sequence[Judged]) -> Confusion:
    counts = [Confusion.of(each.probability >= DECISION, each.slip).counts for each in judged]
    return Confusion(np.sum(counts, axis=0))
