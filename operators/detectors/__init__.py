"""Slip detectors: each computes the probability that the newest sample of a window is slip."""

from collections.abc import Callable

from operators.detectors.detector import Detector, StreamingDetector
from operators.detectors.frequency_cnn import FrequencyCnn, InterleavedFrequencyCnn
from operators.detectors.paper_tcn import PaperTcn
from operators.detectors.psd import Psd
from operators.detectors.tcn import GraspTcn, Tcn
from operators.detectors.weights import Weights

__all__ = [
    "DETECTORS",
    "TRAINED",
    "Detector",
    "FrequencyCnn",
    "GraspTcn",
    "InterleavedFrequencyCnn",
    "PaperTcn",
    "Psd",
    "StreamingDetector",
    "Tcn",
]

DETECTORS: dict[str, Callable[[], Detector]] = {"psd": Psd}  # by name, without weights
TRAINED: dict[str, Callable[[Weights], Detector]] = {  # by name, with weights; the default first
    "tcn": Tcn,
    "tcn_grasp": GraspTcn,
    "paper_tcn": PaperTcn,
    "frequency_cnn_interleaved": InterleavedFrequencyCnn,
    "frequency_cnn": FrequencyCnn,
}
