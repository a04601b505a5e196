"""Slip detectors: each judges the newest sample of a window of counts."""

from collections.abc import Callable

from operators.detectors.detector import Detector
from operators.detectors.paper_tcn import PaperTcn
from operators.detectors.psd import Psd

__all__ = ["DETECTORS", "Detector", "PaperTcn", "Psd"]

DETECTORS: dict[str, Callable[[], Detector]] = {"psd": Psd}  # by name, those that need no weights
