"""Slip detectors: each computes the probability that the newest sample of a window is slip."""

from collections.abc import Callable

from operators.detectors.detector import Detector, StreamingDetector
from operators.detectors.frequency_cnn import FrequencyCnn
from operators.detectors.paper_tcn import PaperTcn
from operators.detectors.psd import Psd
from operators.detectors.tcn import Tcn
from operators.detectors.weights import Weights

__all__ = ["DETECTORS", "TRAINED", "Detector", "FrequencyCnn", "PaperTcn", "Psd", "StreamingDetector", "Tcn"]

DETECTORS: dict[str, Callable[[], Detector]] = {"psd": Psd}  # by name, without weights
TRAINED: dict[str, Callable[[Weights], Detector]] = {  # by name, with weights; the default first
    "tcn": Tcn,
    "paper_tcn": PaperTcn,
    "frequency_cnn": FrequencyCnn,
}
