"""The default detector run by PyTorch and onnxruntime on whole windows, for comparison."""

from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch

from flows.learn.training.onnx_export import export_onnx
from flows.learn.training.tcn_module import DenseTcn
from operators.batch import Counts, Reals
from operators.detectors.tcn import Tcn


class TorchEager:
    """`Tcn` run by PyTorch in eager mode."""

    name = "torch_eager_windowed"

    def __init__(self, tcn: Tcn) -> None:
        self.length = tcn.length
        self._network = DenseTcn.of_detector(tcn)

    def score(self, windows: Counts | Reals) -> Reals:
        """Return the probability of slip of each window (n, length, 6) of zeroed counts; (n,)."""
        with torch.inference_mode():
            counts = torch.as_tensor(windows.astype(np.float32, order="C")).transpose(1, 2)
            probability: Reals = torch.sigmoid(self._network(counts)[:, -1]).numpy().astype(np.float64)
        return probability


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
