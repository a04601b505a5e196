"""`slipflow evaluate`: detectors beside each other on a split that none of them was fitted to."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from connectors.sim.truth import STICK
from flows.learn.evaluation.debounce_tuning import BUDGET, tuned
from flows.learn.evaluation.event_metrics import EventMetrics, Slips, filled
from flows.learn.evaluation.label_changes import LabelChanges
from flows.learn.evaluation.methods import Method, methods
from flows.learn.evaluation.motion_metrics import Cells
from flows.learn.evaluation.sample_metrics import Confusion, Reliability, Roc, known
from flows.learn.labelled_recordings import LabelledRecording, load
from flows.learn.scoring import probabilities
from operators import Debounce
from operators.batch import SLIP, STATIC, UNKNOWN, Flags, Reals
from operators.errors import InputError

PAPER_RULE: Final = Debounce(threshold=0.5, consecutive=2, release=2)  # the robot tests of the paper
CALLED: Final = 0.5  # the least probability that is called slip


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """One method, judged."""

    method: Method
    confusion: Confusion  # against the label
    roc: Roc
    reliability: Reliability
    changes: LabelChanges
    cells: Cells  # by kind of motion
    debounce: Debounce
    chosen: str  # what the settings of the debounce rest on
    events: EventMetrics  # against the label
    paper_rule: EventMetrics  # the same as the paper's robot tests register slip
    sliding: Confusion | None  # against true sliding, where that is known
    sliding_events: EventMetrics | None
    seconds: float  # that scoring took

    def summary(self) -> dict[str, Any]:
        """Its numbers, for a program: shares in %, delays in ms, NaN as null."""
        told: dict[str, float] = {
            **_shares(self.confusion),
            "auc": 100 * self.roc.area,
            "ece": self.reliability.error,
            **_event_numbers(self.events),
        }
        debounce = {name: getattr(self.debounce, name) for name in ("threshold", "consecutive", "release")}
        more: dict[str, Any] = {
            "debounce": {**debounce, "chosen": self.chosen},
            "paper_rule": _plain(_event_numbers(self.paper_rule)),
            "confusion": self.confusion.counts.astype(int).tolist(),
            "far_from_changes": _plain({"accuracy": self.changes.far(100)})["accuracy"],
            "origin": self.method.origin,
        }
        if self.sliding is not None and self.sliding_events is not None:
            more["sliding"] = _plain({**_shares(self.sliding), **_event_numbers(self.sliding_events)})
        return {**_plain(told), **more}


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """All methods, judged on one split of a dataset."""

    dataset: str
    split: str
    recordings: int
    samples: int  # judged
    static: float  # share of these, %
    minutes: float  # of all recordings
    budget: float  # false alarms per static minute that thresholds were chosen for
    results: tuple[Result, ...]  # the most accurate first
    missing: Mapping[str, str]  # methods that were not judged, and why
    label: Confusion | None  # the label itself held against true sliding, where that is known
    seconds: float

    def __getitem__(self, name: str) -> Result:
        return next(result for result in self.results if result.method.name == name)


def evaluate(
    dataset: Path,
    *,
    split: str = "test",
    models: Sequence[Path] = (),
    names: Collection[str] = (),
    budget: float = BUDGET,
    told: Callable[[str], object] = lambda _: None,
) -> Evaluation:
    """Judge methods on a split; thresholds of slip events are chosen on the validation split.

    Args:
        dataset: its folder
        split: train, validation, test, or all
        models: files of weights to judge as well
        names: of the methods that are judged; empty: all
        budget: false alarms per static minute that thresholds are chosen for
        told: is told what is being done

    Raises:
        InputError: if there is no such dataset, split, method or model.
    """
    began = perf_counter()
    told(f"reading {dataset.name}")
    recordings = load(dataset)
    judged = [recording for recording in recordings if split in {recording.split, "all"}]
    if not judged:
        there = ", ".join(sorted({recording.split for recording in recordings} - {""})) or "none"
        raise InputError(str(dataset), f"has no split {split!r}; it has {there}; all takes everything")
    for code, what in ((SLIP, "slip"), (STATIC, "static")):
        if not any((recording.label == code).any() for recording in judged):
            raise InputError(str(dataset), f"has no {what} in its {split} split, so nothing can be judged")
    parts = {
        name: [recording for recording in recordings if recording.split == name]
        for name in ("train", "validation")
    }
    chosen, missing = methods(parts["train"], models, names, told)
    if not chosen:
        raise InputError("evaluate", "; ".join(f"{name}: {reason}" for name, reason in missing.items()))
    judge = _Judge(judged, parts["validation"], budget)
    results = list[Result]()
    for method in chosen:
        told(f"judging {method.name}")
        results.append(judge(method))
    label = np.concatenate([recording.label[at] for recording, at in zip(judged, judge.at, strict=True)])
    return Evaluation(
        dataset.resolve().name,
        split,
        len(judged),
        len(label),
        100 * float((label == 0).mean()) if len(label) else float("nan"),
        sum(map(len, judged)) / 6000,
        budget,
        tuple(sorted(results, key=lambda result: -result.confusion.accuracy)),
        missing,
        judge.label(),
        perf_counter() - began,
    )


class _Judge:
    """Judges one method after the other on the same recordings."""

    def __init__(
        self, recordings: Sequence[LabelledRecording], validation: Sequence[LabelledRecording], budget: float
    ) -> None:
        self.recordings, self.validation, self.budget = recordings, validation, budget
        self.at = [_known(recording) for recording in recordings]
        self.slips = [Slips.labelled(recording) for recording in recordings]
        slid = [recording for recording in recordings if recording.sliding is not None]
        self.whole = len(slid) == len(recordings)  # true sliding is known of all
        self.sliding = [_slid(recording) for recording in slid] if self.whole else []
        self.slid = [true for true in map(Slips.slid, slid) if true is not None] if self.whole else []

    def __call__(self, method: Method) -> Result:
        began = perf_counter()
        scores = [probabilities(method.detector, recording) for recording in self.recordings]
        seconds = perf_counter() - began
        at = [known[np.isfinite(score[known])] for known, score in zip(self.at, scores, strict=True)]
        called = [score[each] >= CALLED for score, each in zip(scores, at, strict=True)]
        truth = [recording.slip[each] for recording, each in zip(self.recordings, at, strict=True)]
        probability, slip = _joined([s[each] for s, each in zip(scores, at, strict=True)]), _flags(truth)
        debounce, chosen = self._debounce(method)
        wrong = [one != other for one, other in zip(called, truth, strict=True)]
        return Result(
            method,
            Confusion.of(_flags(called), slip),
            Roc.of(probability, slip),
            Reliability.of(probability, slip),
            LabelChanges.of([recording.label for recording in self.recordings], at, wrong),
            Cells.of(self.recordings, at, called),
            debounce,
            chosen,
            EventMetrics.of(scores, self.slips, debounce),
            EventMetrics.of(scores, self.slips, PAPER_RULE),
            self._against_sliding(at, called),
            EventMetrics.of(scores, self.slid, debounce) if self.whole else None,
            seconds,
        )

    def label(self) -> Confusion | None:
        """The label, as if it were a method, against true sliding."""
        labels = [recording.slip[at] for recording, at in zip(self.recordings, self.at, strict=True)]
        return self._against_sliding(self.at, labels)

    def _against_sliding(self, at: Sequence[NDArray[np.intp]], called: Sequence[Flags]) -> Confusion | None:
        if not self.whole:
            return None
        truth = [sliding[each] for sliding, each in zip(self.sliding, at, strict=True)]
        return Confusion.of(_flags(called), _flags(truth))

    def _debounce(self, method: Method) -> tuple[Debounce, str]:
        if method.debounce is not None:
            return method.debounce, "its card"
        if not self.validation:
            return PAPER_RULE, "the paper, as there is no validation split"
        scores = [probabilities(method.detector, recording) for recording in self.validation]
        slips = [Slips.labelled(recording) for recording in self.validation]
        return tuned(scores, slips, self.budget), "validation"


def _known(recording: LabelledRecording) -> NDArray[np.intp]:
    at = recording.evaluated(1)
    known: NDArray[np.intp] = at[recording.label[at] != UNKNOWN]
    return known


def _slid(recording: LabelledRecording) -> Flags:
    assert recording.sliding is not None, "only those whose sliding is known are asked for"
    return filled(recording.sliding, STICK)


def _flags(parts: Sequence[Flags]) -> Flags:
    return np.concatenate([np.empty(0, np.bool_), *parts])


def _joined(parts: Sequence[Reals]) -> Reals:
    return np.concatenate([np.empty(0), *parts])


def _shares(confusion: Confusion) -> dict[str, float]:
    keys = ("accuracy", "precision", "recall", "f1", "balanced")
    return {key: float(getattr(confusion, key)) for key in keys}


def _event_numbers(events: EventMetrics) -> dict[str, float]:
    keys = ("false_alarms_per_min", "missed", "onset_ms", "late_ms", "repeated")
    return {key: float(getattr(events, key)) for key in keys}


def _plain(values: Mapping[str, float]) -> dict[str, float | None]:
    """Rounded to what they mean."""
    return {key: known(value, 3) for key, value in values.items()}
