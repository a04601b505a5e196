"""The methods that an experiment compares: our grasp detector and its rivals, each with a tuned threshold."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from operators import Debounce, Grip, GripController, StepGrip
from operators.batch import Counts, Reals
from operators.checks import check_choice
from operators.detectors import Detector
from storage import load_debounce, load_detector
from storage.models import shipped_path

OURS, STEPS, NONE = "ours", "steps", "none"  # rules
RULES: Final = (OURS, STEPS, NONE)
DEFAULT: Final = "tcn_grasp"  # detector
RIVALS: Final = ("threshold", "psd", "paper")


@dataclass(frozen=True)
class StepThreshold:
    """A detector without learning: any cell has moved by more than `threshold` counts in 30 ms."""

    threshold: float = 8.0  # counts, at probability 0.5
    length: int = 4  # samples
    name = "threshold"

    def score(self, windows: Counts | Reals) -> Reals:
        """Return step / (step + threshold) of each window (n, 4, 6), its largest step of a cell; (n,)."""
        step = np.abs(windows[:, -1].astype(np.float64) - windows[:, 0]).max(axis=1)  # (n,) counts
        probability: Reals = step / (step + self.threshold)
        return probability


@dataclass(frozen=True, slots=True)
class Method:
    """A detector and a rule for the grip force.

    Raises:
        ParameterError: if there is no such rule.
    """

    detector: str  # a rival, a detector's name or a model file
    rule: str = OURS

    def __post_init__(self) -> None:
        check_choice("Method", "rule", self.rule, RULES)

    def __str__(self) -> str:
        return f"{self.detector}, {self.rule}"

    def load(self) -> tuple[Detector, GripController]:
        """Return the detector and the controller, which has the threshold of the detector's card.

        The threshold of a rival was tuned on validation grasps.

        Raises:
            InputError: if there is no such detector.
        """
        name = self.detector
        card = shipped_path(f"{name}_grasp") if name in RIVALS else name
        threshold = (load_debounce(card) or Debounce()).threshold
        detector = (
            StepThreshold() if name == "threshold" else load_detector(card if name == "paper" else name)
        )
        if self.rule == STEPS:
            return detector, StepGrip(threshold=threshold)
        ours = Grip(threshold=threshold)
        return detector, replace(ours, gain=0.0, margin=0.0) if self.rule == NONE else ours


METHODS: Final = (Method(DEFAULT), *(Method(name, STEPS) for name in RIVALS))  # rivals: the paper's rule


def parse_method(text: str) -> Method:
    """Return a method from ``DETECTOR`` or ``DETECTOR:RULE``; without a rule, rivals have the paper's.

    Raises:
        ParameterError: on an unknown rule.

    >>> [str(parse_method(text)) for text in ("psd", "psd:none", "mine.safetensors")]
    ['psd, steps', 'psd, none', 'mine.safetensors, ours']
    """
    name, _, rule = text.rpartition(":")
    if name:
        return Method(name, rule)
    return Method(text, STEPS if text in RIVALS else OURS)
