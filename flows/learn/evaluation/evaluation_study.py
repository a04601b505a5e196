"""`slipflow evaluate`: detectors compared on recordings that none of them was fitted to."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
import polars as pl

from flows.learn.evaluation.detector_speed import sample_times
from flows.learn.evaluation.folds import EVERY, Fold, group_folds, split_fold
from flows.learn.evaluation.methods import (
    BASELINES,
    Candidate,
    FittedMethod,
    baselines,
    hold_out_methods,
    trained_methods,
)
from flows.learn.event_metrics import DECISION, PAUSE
from flows.learn.labelled_recordings import LabelledRecording, common_fingertip, load
from flows.learn.measures import CONFUSION, SHARES, judged
from flows.learn.training.trained_model import learned, repeated
from flows.report.results import estimates, joined
from flows.report.table import counted
from flows.run.executor import map_tasks, one_thread
from operators import Debounce
from operators.batch import SLIP, UNKNOWN, Reals
from operators.errors import InputError, SlipflowError

LABEL: Final = "the label"  # as a method, against true sliding
DEFAULT: Final = "tcn"

Progress: TypeAlias = Callable[[int, int], object]  # tasks done, all tasks


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """Results of methods on recordings."""

    subject: str  # what was judged
    results: pl.DataFrame  # long table; methods in the order of their accuracy
    methods: Mapping[str, FittedMethod]  # with the debounce that was used, in the same order
    missing: Mapping[str, str]  # reasons by method
    notes: Sequence[str] = ()  # what a reader must know to judge the numbers
    label: pl.DataFrame = field(default_factory=joined)  # the arm-speed label as a method
    speeds: Mapping[str, float] = field(default_factory=dict[str, float])  # CPU us per sample by method
    as_paper: bool = False  # simulated by the paper's plan: its numbers compare

    @property
    def leader(self) -> str:
        """Name of the default detector, or of the most accurate one."""
        return DEFAULT if DEFAULT in self.methods else next(iter(self.methods))


def evaluate(
    dataset: Path,
    *,
    split: str = "test",
    hold_out: Collection[str] = (),
    train: bool = False,
    names: Collection[str] = (),
    speed: float = 0.0,
    executor: Executor | None = None,
    progress: Progress = lambda _done, _all: None,
) -> Evaluation:
    """Judge methods on a split of a dataset, or on groups of its recordings that are held out.

    On a split, baselines are fitted to the train split, and the validation split tunes the debounce of
    methods without a card.

    Args:
        dataset: Folder of the dataset.
        split: One of train, validation, test and all.
        hold_out: Groups (surfaces or objects) to hold out, one after the other; ``all``: each of them.
        train: With `hold_out`, fit methods to the groups that are not held out.
        names: Files of weights to judge, too, and names: only these methods; empty: all.
        speed: CPU time of each turn of timing the methods, s; 0: they are not timed.
        executor: Executor of `workers`; None: this process.
        progress: Called with the number of fits and judgements done, and of all.

    Raises:
        InputError: if the dataset, split, group, method or model does not exist, or no method can be judged.
        FingertipError: if the recordings have different fingertips.
    """
    trained = trained_methods(names)
    recordings = load(dataset)
    common_fingertip(recordings)
    if hold_out:
        folds = group_folds(recordings, hold_out, str(dataset))
        candidates = [*trained, *hold_out_methods(names, train=train)]
        if left := sorted({*names} & {*BASELINES} - {each.name for each in candidates}):
            raise InputError(", ".join(left), "is not judged on groups: only logistic is, with --train")
        subject, parts = f"{dataset.resolve().name}, held out: {', '.join(hold_out)}", "group"
    else:
        folds = [split_fold(recordings, split, str(dataset))]
        candidates = [*trained, *baselines(names)]
        subject, parts = f"{dataset.resolve().name}, split: {split}", "split"
    chosen = [each for fold in folds for each in fold.judged]
    notes = repeated(recordings, [getattr(each, parts) for each in recordings]) if split != EVERY else []
    tasks = [(each, fold) for each in candidates for fold in folds]
    found = judge_all(subject, tasks, executor=executor, progress=progress)
    labelled = {each.name for each in chosen if len(each.known(1))}
    answers = found.results.filter(pl.col("metric").is_in(CONFUSION), pl.col("value") > 0)
    for each in found.methods.values():
        if known := learned(each.card, chosen):
            notes.append(f"{each.name} has learned from {counted(len(known), 'recording')} of these")
        if silent := labelled - {*answers.filter(method=each.name)["recording"]}:
            many = counted(len(silent), "recording")
            notes.append(f"{each.name} gave no probability at any labelled sample of {many}")
    if speed:
        detectors = {name: method.detector for name, method in found.methods.items()}
        found = replace(found, speeds=sample_times(detectors, chosen, span=speed))
    true = all(each.sliding is not None for each in chosen)
    label = joined(map(_label_results, chosen) if true else ())
    return replace(found, notes=notes, label=label, as_paper=all(each.plan == "paper" for each in chosen))


def judge_all(
    subject: str,
    tasks: Sequence[tuple[Candidate, Fold]],
    *,
    executor: Executor | None = None,
    progress: Progress = lambda _done, _all: None,
) -> Evaluation:
    """Fit candidates to folds and judge them.

    Args:
        subject: What is judged.
        tasks: Candidates and folds; one that fails on a fold, or whose worker dies, has no results.
        executor: Executor of `workers`; None: this process.
        progress: Called with the number of tasks done, and of all.

    Raises:
        InputError: if no method can be judged.
    """
    methods, missing, results = dict[str, FittedMethod](), dict[str, str](), joined()
    answers = map_tasks(_judge, tasks, executor, progress=progress, lost=lambda _, reason: reason)
    for (candidate, _), answer in zip(tasks, answers, strict=True):
        if isinstance(answer, str):
            missing[candidate.name] = answer
        else:
            methods[candidate.name], table = answer
            results = joined([results, table])
    names = [name for name in methods if name not in missing]
    if not names:
        raise InputError("evaluate", "; ".join(f"{name}: {why}" for name, why in missing.items()))
    judged = results.filter(pl.col("method").is_in(names))
    accuracy = estimates(judged, {"accuracy %": SHARES["accuracy %"]}, draws=0)
    order = accuracy.sort("value", descending=True, nulls_last=True)["method"].to_list() or names  # if empty
    return Evaluation(
        subject,
        joined(results.filter(method=name) for name in order),
        {name: methods[name] for name in order},
        missing,
    )


@one_thread()
def _judge(task: tuple[Candidate, Fold]) -> tuple[FittedMethod, pl.DataFrame] | str:
    """Return a fitted method and its results on a fold; or why there are none."""
    candidate, fold = task
    try:
        method = candidate.fit(fold).debounced(fold)
        return method, method_results(method, fold.judged, fold=fold.name)
    except SlipflowError as error:  # such as a detector for another fingertip
        return error.reason if isinstance(error, InputError) else str(error)


def method_results(
    method: FittedMethod, recordings: Iterable[LabelledRecording], *, condition: str = "", fold: str = ""
) -> pl.DataFrame:
    """Judge a method, whose debounce was chosen, on recordings; see `judged`."""
    assert method.debounce is not None, "it was chosen"
    key = {"method": method.name, "condition": condition, "fold": fold}
    return joined(
        judged(each, each.probabilities(method.detector), method.debounce, **key) for each in recordings
    )


def _label_results(recording: LabelledRecording) -> pl.DataFrame:
    """Judge the arm-speed label as if it were a detector; events are its slips as in `TrueSlips`."""
    probability: Reals = np.where(recording.label == UNKNOWN, np.nan, recording.label == SLIP)
    probability[: recording.sampling.warm_up] = np.nan
    rule = Debounce(DECISION, 1, recording.sampling.samples(PAUSE))
    return judged(recording, probability, rule, method=LABEL)
