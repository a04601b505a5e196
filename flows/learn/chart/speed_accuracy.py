"""Speed against accuracy: every detector and size, timed and judged in one run.

Beside them stands the default detector as a user would otherwise run it: on windows, by torch, eagerly, and
by onnxruntime.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Any, Final

from flows.learn.chart.chart_points import Goal, Point, with_front
from flows.learn.chart.detector_speed import costs
from flows.learn.evaluation import published
from flows.learn.evaluation.debounce_tuning import BUDGET, tuned
from flows.learn.evaluation.event_metrics import Slips
from flows.learn.evaluation.judgement import Judgement
from flows.learn.evaluation.methods import methods
from flows.learn.labelled_recordings import by_split, load
from flows.learn.scoring import probabilities
from flows.run.processes import one_thread
from operators.detectors.detector import Detector, Streaming
from operators.detectors.tcn import Tcn
from operators.errors import InputError

DEFAULT: Final = "tcn"
TORCH: Final = "torch_eager_windowed"
ONNX: Final = "onnxruntime_windowed"
_NEEDED: Final = {TORCH: ("torch",), ONNX: ("onnx", "onnxruntime")}  # modules
_RIVALS: Final = {TORCH: 500.0, ONNX: 50.0}  # times that the default detector is to be faster
_CORE: Final = 2.0  # %, of a core, that 64 fingertips may take at most
MANY: Final = 64  # fingertips
_TIMED: Final = 500  # samples of a recording that are gone through to time a detector
_ROUNDS: Final = (15, 5)  # of timing one fingertip, and many


@dataclass(frozen=True, slots=True)
class Chart:
    """All points of one run."""

    dataset: str
    recordings: int  # of the test split
    points: tuple[Point, ...]
    skipped: Mapping[str, str]  # what is not among them, and why
    seconds: float  # that it took

    def goals(self) -> list[Goal]:
        """How fast the default detector is, against what is hoped for, as far as it was measured."""
        points = {point.name: point for point in self.points}
        default = points.get(DEFAULT)
        if default is None:
            return []
        ratios = [
            Goal(f"{DEFAULT}: times faster than {name}", wanted, points[name].us / default.us)
            for name, wanted in _RIVALS.items()
            if name in points
        ]
        most = "64 fingertips at 100 Hz, % of a core"
        return [*ratios, Goal(most, _CORE, default.core_64, at_least=False)]

    def json(self) -> dict[str, Any]:
        """All of it, for a program."""
        return {
            "dataset": self.dataset,
            "recordings": self.recordings,
            "points": [point.json() for point in self.points],
            "paper": {
                name: {"accuracy": accuracy, "us": None} for name, accuracy in published.ACCURACY.items()
            },
            "goals": [
                {"goal": goal.text, "wanted": goal.wanted, "reached": goal.reached, "met": goal.met}
                for goal in self.goals()
            ],
            "skipped": dict(self.skipped),
            "seconds": self.seconds,
        }


def chart(
    dataset: Path,
    models: Sequence[Path] = (),
    *,
    names: Collection[str] = (),
    budget: float = BUDGET,
    span: float = 0.02,
    told: Callable[[str], object] = lambda _: None,
) -> Chart:
    """Judge detectors on a dataset's test split, and time them.

    Args:
        dataset: Simple detectors are fitted to its training split, and slips are debounced as its validation
            split has it, where a model's card does not say how.
        models: files of weights to judge as well, such as networks of other sizes.
        names: of the methods that are judged; empty: all.
        budget: false alarms per static minute that thresholds are chosen for.
        span: CPU s of each turn of timing.
        told: Is told what is being done, and what is skipped.

    Raises:
        InputError: if the dataset is none, or has no validation or test split, or if there is no such method
            or model.
    """
    began = perf_counter()
    told(f"reading {dataset.name}")
    train, validation, test = by_split(load(dataset)).values()
    for split, part in (("validation", validation), ("test", test)):
        if not part:
            raise InputError(
                str(dataset), f"has no {split} split: slipflow simulate makes datasets with all splits"
            )
    with one_thread():
        chosen, skipped = methods(train, models, names, told)
    detectors = {method.name: method.detector for method in chosen}
    rules = {method.name: method.debounce for method in chosen}
    beside, missing = _beside(detectors.get(DEFAULT))
    skipped |= missing
    for name, reason in skipped.items():
        told(f"SKIPPED: {name}, because {reason}")
    detectors |= beside
    slips = [Slips.labelled(recording) for recording in validation]
    judged = dict[str, Judgement]()
    with one_thread():
        for name, detector in detectors.items():
            told(f"judging {name}")
            rule = rules.get(DEFAULT if name in beside else name)
            if rule is None:
                rule = tuned([probabilities(detector, recording) for recording in validation], slips, budget)
            rules[name] = rule
            judged[name] = Judgement.of(
                test, [probabilities(detector, recording) for recording in test], rule
            )
        told("timing all of them by turns")
        counts = max((recording.counts for recording in test), key=len)[-_TIMED:]
        one = costs(detectors, counts, rounds=_ROUNDS[0], span=span)
        many = costs(detectors, counts, fingers=MANY, rounds=_ROUNDS[1], span=span)
    points = [
        Point(name, one[name], many[name], isinstance(detector, Streaming), judged[name], name in beside)
        for name, detector in detectors.items()
    ]
    return Chart(
        dataset.resolve().name, len(test), tuple(with_front(points)), skipped, perf_counter() - began
    )


def _beside(default: Detector | None) -> tuple[dict[str, Detector], dict[str, str]]:
    """The default detector run by other libraries, by name; and for those that cannot, the reason."""
    if not isinstance(default, Tcn):
        return {}, dict.fromkeys(_NEEDED, f"there is no {DEFAULT}")
    result, missing = dict[str, Detector](), dict[str, str]()
    for name, needed in _NEEDED.items():
        if absent := [module for module in needed if find_spec(module) is None]:
            missing[name] = f"{' and '.join(absent)} cannot be imported"
        elif name == TORCH:
            from flows.learn.chart.torch_eager import TorchEager  # noqa: PLC0415 - an extra, slow to import

            result[name] = TorchEager(default)
        else:
            from flows.learn.chart.onnx_windowed import OnnxWindowed  # noqa: PLC0415 - the same

            result[name] = OnnxWindowed(default)
    return result, missing
