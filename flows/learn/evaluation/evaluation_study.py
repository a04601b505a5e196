"""`slipflow evaluate`: detectors compared on a split that none of them was fitted to."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from flows.learn.evaluation.debounce_tuning import BUDGET, tuned_on
from flows.learn.evaluation.event_metrics import (
    DECISION,
    PAUSE,
    EventMetrics,
    Performance,
    Slips,
    performances,
)
from flows.learn.evaluation.intervals import Figures, Judged, figures
from flows.learn.evaluation.methods import Method, for_fingertip, trained_methods, with_baselines
from flows.learn.evaluation.motion_metrics import MotionConfusions
from flows.learn.evaluation.sample_metrics import Confusion, LabelChanges, Reliability, Roc
from flows.learn.labelled_recordings import (
    LABELS,
    LabelledRecording,
    Target,
    by_split,
    common_fingertip,
    hand_label_summary,
    load,
)
from flows.learn.leaks.leak import (
    Leak,
    card_leaks,
    constant_leaks,
    lists_recordings,
    overlapping,
    split_leaks,
)
from flows.learn.provenance import dataset_digest
from flows.learn.sampling import Sampling
from flows.learn.scoring import probabilities
from flows.run.executor import one_thread
from operators import Debounce
from operators.batch import SLIP, STATIC, UNKNOWN, Reals
from operators.errors import InputError
from operators.extras import require_extra

PAPER_RULE: Final = Debounce(threshold=0.5, consecutive=2, release=2)  # in the paper's robot tests, 100 Hz


@dataclass(frozen=True, slots=True, eq=False)
class MethodResult:
    """Results of one method."""

    method: Method
    confusion: Confusion  # against the label
    roc: Roc
    reliability: Reliability
    changes: LabelChanges
    motions: MotionConfusions
    debounce: Debounce
    chosen_on: str  # origin of the debounce settings
    events: EventMetrics  # against the label
    paper_rule: EventMetrics  # the same with the debounce of the paper's robot tests
    performance: Mapping[Target, Performance]  # against each target that the recordings have
    figures: Figures  # against the label, with intervals over recordings


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """Results of all methods on one split of a dataset."""

    dataset: str
    split: str
    recordings: int
    samples: int  # evaluated
    static: float  # share of static samples, %
    minutes: float  # of all recordings
    sampling: Sampling  # of all recordings
    budget: float  # false alarms per static minute that the debounce was tuned for
    results: tuple[MethodResult, ...]  # the most accurate first
    missing: Mapping[str, str]  # reasons by method
    label: Mapping[Target, Performance]  # of the arm-speed label itself, against each target
    leaks: tuple[Leak, ...]  # what inflates the results
    unchecked: tuple[str, ...]  # methods whose card does not list the recordings of their training
    by_hand: str = ""  # line with the labels by hand; empty: none

    @property
    def leader(self) -> MethodResult:
        """Method that the findings are about: the default detector, or the most accurate one."""
        return next((each for each in self.results if each.method.name == "tcn"), self.results[0])


def evaluate(
    dataset: Path,
    *,
    split: str = "test",
    models: Sequence[Path] = (),
    names: Collection[str] = (),
    budget: float = BUDGET,
    labels: str = LABELS[0],
    log: Callable[[str], object] = lambda _: None,
) -> Evaluation:
    """Evaluate methods on a split.

    Baselines are fitted to the train split, and the validation split tunes the debounce of methods without
    a card. Recordings that are judged, or share rows with judged ones, take no part in either.

    Args:
        dataset: Folder of the dataset.
        split: One of train, validation, test and all.
        models: Files of weights to evaluate as well.
        names: Only these methods, and those of `models`; empty: all.
        budget: False alarms per static minute that the debounce is tuned for.
        labels: One of `LABELS`: ``hand``, or ``arm`` to ignore labels by hand.
        log: Receives progress messages.

    Raises:
        InputError: if the train extra is missing, or the dataset, split, a method or a model does not exist.
        FingertipError: if the recordings have different fingertips.
    """
    require_extra("train", "evaluate")
    trained = trained_methods(models, names)
    log(f"reading {dataset.name}")
    everything = load(dataset, labels=labels)
    recordings = _of_split(dataset, everything, split)
    if by_hand := hand_label_summary(recordings):
        log(by_hand)
    fingertip = common_fingertip(everything)
    trained, misfits = for_fingertip(trained, fingertip, log)
    bad = overlapping(everything, recordings)
    parts = by_split(each for place, each in enumerate(everything) if place not in bad)
    leaks, unchecked = _card_leaks(dataset, trained, recordings)
    with one_thread():
        chosen, missing = with_baselines(trained, parts["train"], names, log, misfits)
        if not chosen:
            raise InputError("evaluate", "; ".join(f"{name}: {why}" for name, why in missing.items()))
        evaluator = _Evaluator(recordings, parts["validation"], budget)
        results = list[MethodResult]()
        for method in chosen:
            log(f"evaluating {method.name}")
            results.append(evaluator.result(method))
    if split != "all":  # else nothing was fitted
        leaks = [*split_leaks([everything]), *leaks]
    for result in results:
        leaks += constant_leaks(result.method.name, result.confusion.counts)
    for leak in leaks:
        log(f"leak: {leak.finding}")
    slip = [each.slip[at] for each, at in zip(recordings, evaluator.known, strict=True)]
    slips, sampling = np.concatenate(slip), recordings[0].sampling
    label_rule = Debounce(DECISION, 1, sampling.samples(PAUSE))  # slips as in `Slips`
    return Evaluation(
        dataset.resolve().name,
        split,
        len(recordings),
        len(slips),
        100 * float((~slips).mean()) if len(slips) else float("nan"),
        sampling.minutes(sum(map(len, recordings))),
        sampling,
        budget,
        tuple(sorted(results, key=lambda result: -result.confusion.accuracy)),
        missing,
        performances(recordings, [_certain(each) for each in recordings], label_rule),
        tuple(leaks),
        unchecked,
        by_hand,
    )


def _card_leaks(
    dataset: Path, methods: Sequence[Method], judged: Sequence[LabelledRecording]
) -> tuple[list[Leak], tuple[str, ...]]:
    """Return the leaks from judged recordings to models, and the methods whose cards list no recordings."""
    digest = dataset_digest(dataset)
    leaks = [leak for each in methods for leak in card_leaks(each.name, each.card, judged, digest)]
    return leaks, tuple(each.name for each in methods if not lists_recordings(each.card))


def _of_split(dataset: Path, recordings: Sequence[LabelledRecording], split: str) -> list[LabelledRecording]:
    chosen = [recording for recording in recordings if split in {recording.split, "all"}]
    if not chosen:
        there = ", ".join(sorted({recording.split for recording in recordings} - {""})) or "none"
        raise InputError(
            str(dataset), f"has no split {split!r}; it has {there}; `--split all` takes everything"
        )
    for code, name in ((SLIP, "slip"), (STATIC, "static")):
        if not any((recording.label == code).any() for recording in chosen):
            raise InputError(str(dataset), f"has no {name} in its {split} split; choose another split")
    return chosen


class _Evaluator:
    """Evaluator of methods on the same recordings."""

    def __init__(
        self,
        recordings: Sequence[LabelledRecording],
        validation: Sequence[LabelledRecording],
        budget: float,
    ) -> None:
        self.recordings, self.validation, self.budget = recordings, validation, budget
        self.sampling = recordings[0].sampling
        self.paper_rule = self.sampling.rule(PAPER_RULE)
        self.known = [recording.known(1) for recording in recordings]
        self.slips = [Slips.labelled(recording) for recording in recordings]

    def result(self, method: Method) -> MethodResult:
        scores = [probabilities(method.detector, recording) for recording in self.recordings]
        at = [known[np.isfinite(score[known])] for known, score in zip(self.known, scores, strict=True)]
        probability = [score[each] for score, each in zip(scores, at, strict=True)]
        predicted = [each >= DECISION for each in probability]
        truth = [recording.slip[each] for recording, each in zip(self.recordings, at, strict=True)]
        wrong = [one != other for one, other in zip(predicted, truth, strict=True)]
        slip = np.concatenate(truth)
        debounce, chosen_on = self._debounce(method)
        return MethodResult(
            method,
            Confusion.of(np.concatenate(predicted), slip),
            Roc.of(np.concatenate(probability), slip),
            Reliability.of(np.concatenate(probability), slip),
            LabelChanges.of([each.label for each in self.recordings], at, wrong, self.sampling),
            MotionConfusions.of(self.recordings, at, predicted),
            debounce,
            chosen_on,
            EventMetrics.of(scores, self.slips, debounce),
            EventMetrics.of(scores, self.slips, self.paper_rule),
            performances(self.recordings, scores, debounce),
            figures([[Judged.of(*own, debounce)] for own in zip(self.recordings, scores, strict=True)]),
        )

    def _debounce(self, method: Method) -> tuple[Debounce, str]:
        if method.debounce is not None:
            return method.debounce, "its card"
        if not self.validation:
            return self.paper_rule, "the paper, as no validation split is left to tune it on"
        return tuned_on(self.validation, method.detector, self.budget), "validation"


def _certain(recording: LabelledRecording) -> Reals:
    """Return the label as probabilities (n,); NaN: not evaluated or unknown."""
    probability = np.where(recording.label == UNKNOWN, np.nan, recording.label == SLIP)
    probability[: recording.sampling.warm_up] = np.nan
    return probability
