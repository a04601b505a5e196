"""The default detector by onnxruntime, on whole windows."""

from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flows.learn.training.onnx_export import export
from operators.batch import Counts, Reals
from operators.detectors.tcn import Tcn


class OnnxWindowed:
    """`Tcn` as its ONNX export says it, run by one thread."""

    name = "onnxruntime_windowed"

    def __init__(self, tcn: Tcn) -> None:
        runtime: Any = import_module("onnxruntime")  # an extra; it declares no types
        options = runtime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self.length = tcn.length
        with TemporaryDirectory() as folder:
            path = Path(folder) / "tcn.onnx"
            export(arrays(tcn), path)
            self._session = runtime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])

    def score(self, windows: Counts | Reals) -> Reals:
        """The probability of slip of each window (n, length, 6) of zeroed counts; (n,)."""
        inputs = {"counts": windows.astype(np.float32, order="C")}
        probability: Reals = self._session.run(None, inputs)[0].astype(np.float64)
        return probability


def arrays(tcn: Tcn) -> dict[str, NDArray[Any]]:
    """The weights that a detector was made of, by name."""
    *convs, first, second, out = tcn.layers
    result: dict[str, NDArray[Any]] = {
        "dilations": np.array([layer.dilation for layer in convs[::2]]),
        "position_scale": np.array([tcn.position_scale]),
        "step_scale": np.array([tcn.step_scale]),
    }
    for number, layer in enumerate(convs):
        result[f"conv{number}/kernel"], result[f"conv{number}/bias"] = layer.kernel, layer.bias
    for name, layer in (("dense0", first), ("dense1", second), ("out", out)):
        result[f"{name}/kernel"], result[f"{name}/bias"] = layer.kernel[0], layer.bias
    return result
