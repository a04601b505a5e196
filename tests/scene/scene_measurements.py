"""Recordings of the simulated scene, and the detectors that are evaluated on them."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from time import process_time
from typing import Final, Self

from connectors import Trace
from connectors.files.column_map import ColumnMap
from connectors.sim.paper_plan import PaperPlan
from flows.lab.simulation import PLANS
from flows.learn.evaluation.motion_metrics import MotionConfusions
from flows.learn.labelled_recordings import LabelledRecording, simulated_recording, simulated_recordings
from operators.batch import UNKNOWN
from operators.checks import check_choice
from operators.detectors import TRAINED, Detector
from operators.errors import InputError
from storage import load_detector
from tests.scene.scene_ablation import GRIDS, TERMS
from tests.scene.scene_judges import by_motion, fit

NETWORK: Final = "paper's TCN"
DEFAULT: Final = "tcn"  # of the shipped detectors
LOGISTIC: Final = "logistic regression"


@dataclass(frozen=True, slots=True)
class Size:
    """Extent of the study."""

    plan: PaperPlan = field(default_factory=PaperPlan)
    # for the ablation and for fitting
    reduced: PaperPlan = field(default_factory=lambda: PaperPlan(repeats=2, rotations=1))
    seeds: int = 3  # of the ablation
    hop: int = 5  # samples between evaluated samples
    terms: tuple[str, ...] = (*TERMS, *GRIDS)  # of the ablation
    timed: float = 20.0  # simulated s
    draws: int = 300  # of bootstraps

    @classmethod
    def of(cls, plan: str) -> Self:
        """Return the extent for a plan of `flows.lab.simulation`: full for `paper`, short for others.

        Raises:
            ParameterError: if there is no such plan.
        """
        check_choice("scene", "plan", plan, PLANS)
        if plan == "paper":
            return cls()
        return cls(
            PLANS[plan], PLANS[plan], seeds=2, terms=("texture", "relaxation", "6 x 4 nodes"), timed=2.0
        )


class Measurements:
    """Data that several sections share.

    Args:
        seed: Of the recordings that detectors are evaluated on; detectors are fitted to those of other seeds.
        judge: File with the weights of the paper's TCN, which was trained on real recordings only.
        trace: A real trace with labels, as CSV.
        size: Extent of the study.
        log: Called with each step of the work.
    """

    def __init__(
        self, seed: int, judge: Path | None, trace: Path | None, size: Size, log: Callable[[str], None]
    ) -> None:
        self.seed, self.size, self.log = seed, size, log
        self.network: Detector | None = None if judge is None else load_detector(judge)
        self.trace = None if trace is None else read_trace(trace)
        log("simulating the plan")
        simulated_recording(next(iter(size.plan.scenes(seed))), seed)  # compiles the physics
        start = process_time()
        self.recordings = simulated_recordings(size.plan, seed)
        self.simulating = process_time() - start  # CPU s, with alignment and labels
        training = simulated_recordings(size.reduced, seed + 500)
        log("fitting the detectors")
        samples = sum(map(len, training))
        self.fitted_to = f"{len(training)} simulated recordings ({samples} samples) of another seed"
        self.psd, self.logistic = fit(training, size.hop)
        self.shipped: dict[str, Detector] = {name: load_detector(name) for name in TRAINED}
        judges: dict[str, Detector] = {} if self.network is None else {NETWORK: self.network}
        self.by_motion: dict[str, MotionConfusions] = {}
        for name, detector in {**judges, LOGISTIC: self.logistic}.items():
            log(f"evaluating the {name}")
            self.by_motion[name] = by_motion(detector, self.recordings, size.hop)


def read_trace(path: Path) -> LabelledRecording:
    """Read a real trace.

    Raises:
        InputError: if a row has no label, or the file is not a trace.
    """
    trace = Trace(path, ColumnMap(zeroed=True))
    if (trace.labels == UNKNOWN).any():
        raise InputError(str(path), "has rows without a label; label each row")
    return LabelledRecording(trace.touch.counts, trace.labels, path.stem, name=path.stem)
