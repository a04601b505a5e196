"""What the sections of the scene's report share: recordings, and the detectors that judge them."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from time import process_time
from typing import Final, Self

from connectors import CsvTrace
from connectors.sim.paper_plan import Collection
from flows.lab.simulation import PLANS
from flows.learn.evaluation.motion_metrics import Cells
from flows.learn.labelled_recordings import LabelledRecording, simulated_recordings
from operators.batch import UNKNOWN
from operators.detectors import TRAINED, Detector
from operators.errors import InputError, ParameterError
from storage import load_detector
from tests.scene.scene_ablation import GRIDS, TERMS
from tests.scene.scene_judges import cells, fitted

NETWORK: Final = "paper's TCN"
DEFAULT: Final = "tcn"  # of the detectors that ship


@dataclass(frozen=True, slots=True)
class Size:
    """How much is measured."""

    plan: Collection = field(default_factory=Collection)
    # of the ablation and the fitting
    reduced: Collection = field(default_factory=lambda: Collection(repeats=2, rotations=1))
    seeds: int = 3  # of the ablation
    hop: int = 5  # samples from one judged window to the next
    terms: tuple[str, ...] = (*TERMS, *GRIDS)  # of the ablation
    timed: float = 20.0  # simulated s

    @classmethod
    def of(cls, plan: str) -> Self:
        """What suits a plan of `flows.lab.simulation`: all of paper, a hasty look at others.

        Raises:
            ParameterError: on a plan that there is not.
        """
        if plan == "paper":
            return cls()
        if plan not in PLANS:
            raise ParameterError("simulate", "plan", plan, f"one of {', '.join(PLANS)}")
        return cls(PLANS[plan], PLANS[plan], seeds=2, terms=("texture", "creep", "6 x 4 nodes"), timed=2.0)


class Measured:
    """What several sections are made of.

    Args:
        seed: Of the recordings that are judged; those that detectors are fitted to have others.
        judge: File with the weights of the paper's TCN, which knows real recordings only.
        trace: A real trace with labels, as CSV.
        size: How much is measured.
        told: Is told what is being done.
    """

    def __init__(
        self, seed: int, judge: Path | None, trace: Path | None, size: Size, told: Callable[[str], None]
    ) -> None:
        self.seed, self.size, self.told = seed, size, told
        self.network: Detector | None = None if judge is None else load_detector(judge)
        self.trace = None if trace is None else read_trace(trace)
        told("simulating the plan")
        begin = process_time()
        self.trials = simulated_recordings(size.plan, seed)
        self.simulating = process_time() - begin  # CPU s, with alignment and labels
        training = simulated_recordings(size.reduced, seed + 500)
        told("fitting the detectors")
        self.fitted_to = (
            f"{len(training)} simulated recordings ({sum(map(len, training))} samples) of another seed"
        )
        self.psd, self.logistic = fitted(training, size.hop)
        self.shipped: dict[str, Detector] = {name: load_detector(name) for name in TRAINED}
        self.judges: dict[str, Detector] = {"logistic regression": self.logistic}
        if self.network is not None:
            self.judges = {NETWORK: self.network, **self.judges}
        self.cells: dict[str, Cells] = {}
        for name, detector in self.judges.items():
            told(f"judging by the {name}")
            self.cells[name] = cells(detector, self.trials, size.hop)


def read_trace(path: Path) -> LabelledRecording:
    """Read a real trace with labels.

    Raises:
        InputError: if a row has no label, or the file is no trace.
    """
    trace = CsvTrace(path, zeroed=True)
    if (trace.labels == UNKNOWN).any():
        raise InputError(str(path), "has rows without a label; label each row")
    return LabelledRecording(trace.touch.counts, trace.labels, path.stem, name=path.stem)
