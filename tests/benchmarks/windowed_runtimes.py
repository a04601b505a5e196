"""The default detector run by onnxruntime on whole windows, for comparison."""

from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from flows.learn.training.onnx_export import export_onnx
from operators.batch import Counts, Reals
from operators.detectors.tcn import Tcn


class OnnxWindowed:
    """`Tcn` run by onnxruntime on one thread."""

    name = "onnxruntime_windowed"

    def __init__(self, tcn: Tcn) -> None:
        runtime: Any = import_module("onnxruntime")  # an extra without type annotations
        options = runtime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self.length = tcn.length
        with TemporaryDirectory() as folder:
            path = Path(folder) / "tcn.onnx"
            export_onnx(tcn, path)
            self._session = runtime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])

    def score(self, windows: Counts | Reals) -> Reals:
        """Return the probability of slip of each window (n, length, 6) of zeroed counts; (n,)."""
        inputs = {"counts": windows.astype(np.float32, order="C")}
        probability: Reals = self._session.run(None, inputs)[0].astype(np.float64)
        return probability
