"""Export of the TCN as ONNX, for runtimes without Python."""

from io import BytesIO
from pathlib import Path
from typing import Any, Final
from warnings import catch_warnings, simplefilter

from operators.detectors.tcn import Tcn
from operators.extras import require_extra
from storage.files import put

OPSET: Final = 17


def _asinh(graph: Any, x: Any) -> Any:  # noqa: ANN401 - nodes of torch's graph
    """Add ONNX's operator Asinh, which torch's exporter lacks."""
    return graph.op("Asinh", x)


def export_onnx(tcn: Tcn, path: Path) -> None:
    """Write a TCN as ONNX: input ``counts`` (n, length, cells) float32, zeroed; output ``probability`` (n,).

    Raises:
        InputError: if the train extra is missing.
        OSError: if the file cannot be written.
    """
    require_extra("train", "ONNX export")
    import torch  # noqa: PLC0415 - an extra, slow to import
    from torch import nn, onnx  # noqa: PLC0415

    from flows.learn.training.tcn_module import DenseTcn  # noqa: PLC0415 - imports torch

    class Windowed(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.network = DenseTcn.of_detector(tcn)

        def forward(self, windows: torch.Tensor) -> torch.Tensor:
            return self.network.newest(windows)

    exporter: Any = onnx  # lacks some type annotations
    exporter.register_custom_op_symbolic("aten::asinh", _asinh, OPSET)
    model = BytesIO()
    with catch_warnings():
        simplefilter("ignore", DeprecationWarning)  # the newer exporter needs onnxscript
        exporter.export(
            Windowed().eval(),
            (torch.zeros(2, tcn.length, tcn.cells),),
            model,
            input_names=["counts"],
            output_names=["probability"],
            dynamic_axes={"counts": {0: "n"}, "probability": {0: "n"}},
            opset_version=OPSET,
            dynamo=False,
        )
    put(path, model.getvalue())
