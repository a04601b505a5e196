"""`slipflow chart`: speed against accuracy of every detector, measured in one run.

For comparison, PyTorch and onnxruntime also run the default detector on windows.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from flows.learn.chart.detector_speed import costs
from flows.learn.evaluation.debounce_tuning import BUDGET, tuned_on
from flows.learn.evaluation.event_metrics import Performance, performances
from flows.learn.evaluation.methods import for_fingertip, trained_methods, with_baselines
from flows.learn.labelled_recordings import Target, by_split, common_fingertip, hand_label_summary, load
from flows.learn.scoring import probabilities
from flows.run.executor import one_thread
from operators.detectors.detector import Detector, Streaming
from operators.detectors.tcn import Tcn
from operators.errors import InputError
from operators.extras import require_extra

DEFAULT: Final = "tcn"
MANY: Final = 64  # fingertips
_TIMED: Final = 500  # samples of a recording that the timing repeats
_ROUNDS: Final = (15, 5)  # of timing: one fingertip, many


@dataclass(frozen=True, slots=True)
class Point:
    """Detector with its speed and its performance on the test split."""

    name: str
    us: float  # CPU time for a sample of one fingertip
    us_64: float  # CPU time for a sample of 64 fingertips
    streams: bool  # runs sample by sample; False: on windows
    performances: Mapping[Target, Performance]  # against each target that the dataset has labels for
    same: bool = False  # is the default detector, run by another library
    pareto: bool = False  # no other point is faster and more accurate
    rate: float = 100.0  # Hz, of the data

    @property
    def performance(self) -> Performance:
        """Performance against the arm-speed label."""
        return self.performances["arm-speed"]

    @property
    def core_64(self) -> float:
        """Share of one core that 64 fingertips at the rate of the data take, %."""
        return 100 * self.us_64 * 1e-6 * self.rate


@dataclass(frozen=True, slots=True)
class Chart:
    """Points of one run."""

    dataset: str
    recordings: int  # of the test split
    points: tuple[Point, ...]
    missing: Mapping[str, str]  # reasons by method


def chart(
    dataset: Path,
    models: Sequence[Path] = (),
    *,
    names: Collection[str] = (),
    budget: float = BUDGET,
    span: float = 0.02,
    log: Callable[[str], object] = lambda _: None,
) -> Chart:
    """Evaluate detectors on the test split of a dataset, and measure their CPU time.

    Args:
        dataset: Folder; its training split fits the baselines, its validation split tunes the debounce of
            methods without a card.
        models: Files of weights to include, such as networks of other sizes.
        names: Only these methods, and those of `models`; empty: all.
        budget: False alarms per static minute that the debounce is tuned for.
        span: CPU time of each turn of timing, s.
        log: Receives progress messages.

    Raises:
        InputError: if the train extra is missing, the dataset does not exist or lacks a validation or test
            split, or a method or model does not exist, or none can be evaluated.
        FingertipError: if the recordings have different fingertips.
    """
    require_extra("train", "chart")
    trained = trained_methods(models, names)
    log(f"reading {dataset.name}")
    recordings = load(dataset)
    if by_hand := hand_label_summary(recordings):
        log(by_hand)
    train, validation, test = by_split(recordings).values()
    for split, part in (("validation", validation), ("test", test)):
        if not part:
            reason = f"has no {split} split: `slipflow simulate` makes datasets with all splits"
            raise InputError(str(dataset), reason)
    trained, misfits = for_fingertip(trained, common_fingertip(recordings), log)
    with one_thread():
        chosen, missing = with_baselines(trained, train, names, log, misfits)
    if not chosen:
        raise InputError("chart", "; ".join(f"{name}: {why}" for name, why in missing.items()))
    detectors = {method.name: method.detector for method in chosen}
    rules = {method.name: method.debounce for method in chosen}
    others = _by_other_libraries(detectors.get(DEFAULT))  # imports torch: `one_thread` then limits it, too
    with one_thread():
        found = dict[str, Mapping[Target, Performance]]()
        for name, detector in {**detectors, **others}.items():
            log(f"evaluating {name}")
            rule = rules.get(DEFAULT if name in others else name)
            if rule is None:
                rule = rules[name] = tuned_on(validation, detector, budget)
            scores = [probabilities(detector, recording) for recording in test]
            found[name] = performances(test, scores, rule)
        log("timing the detectors in turns")
        detectors |= others
        counts = max((recording.counts for recording in test), key=len)[-_TIMED:]
        one = costs(detectors, counts, rounds=_ROUNDS[0], span=span)
        many = costs(detectors, counts, fingers=MANY, rounds=_ROUNDS[1], span=span)
    rate = test[0].sampling.rate
    points = [
        Point(
            name, one[name], many[name], isinstance(each, Streaming), found[name], name in others, rate=rate
        )
        for name, each in detectors.items()
    ]
    return Chart(dataset.resolve().name, len(test), tuple(with_front(points)), missing)


def with_front(points: Sequence[Point]) -> list[Point]:
    """Return the points, and mark those on the Pareto front of speed and accuracy."""
    return [replace(point, pareto=not any(_dominates(other, point) for other in points)) for point in points]


def _dominates(one: Point, other: Point) -> bool:
    us, accuracy = (one.us, other.us), (one.performance.accuracy, other.performance.accuracy)
    at_least = us[0] <= us[1] and accuracy[0] >= accuracy[1]
    return at_least and (us[0] < us[1] or accuracy[0] > accuracy[1])


def _by_other_libraries(default: Detector | None) -> dict[str, Detector]:
    """Return the default detector as other libraries run it, by name."""
    if not isinstance(default, Tcn):
        return {}
    from flows.learn.chart.windowed_runtimes import OnnxWindowed, TorchEager  # noqa: PLC0415 - imports torch

    return {each.name: each for each in (TorchEager(default), OnnxWindowed(default))}
