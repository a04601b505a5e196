"""Export of the TCN as ONNX, for runtimes without Python."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from operators.detectors.tcn import Tcn
from operators.detectors.weights import CausalLayer
from operators.extras import require_extra
from storage.files import put

OPSET: Final = 17
_IR_VERSION: Final = 8  # of the file, which runtimes since 2022 read
_DENSE: Final = 3  # number of dense layers at the end


def export_onnx(tcn: Tcn, path: Path) -> None:
    """Write a TCN as ONNX: input ``counts`` (n, length, cells) float32, zeroed; output ``probability`` (n,).

    Convolutions without padding compute only the steps that the newest sample depends on.

    Raises:
        InputError: if the onnx extra is missing.
        OSError: if the file cannot be written.
    """
    require_extra("onnx", "ONNX export")
    graph = _Graph()
    x = graph.features(tcn)
    for first, second in zip(tcn.layers[:-_DENSE:2], tcn.layers[1:-_DENSE:2], strict=True):
        y = graph.convolved(graph.convolved(x, first), second)
        x = graph.node("Add", y, graph.sliced(x, _past(first) + _past(second))) if second.skip else y
    *hidden, out = tcn.layers[-_DENSE:]
    for layer in hidden:
        x = graph.convolved(x, layer)
    probability = graph.node("Sigmoid", graph.convolved(x, out, activated=False))  # (n, 1, 1)
    graph.node("Squeeze", probability, graph.constant(np.array([1, 2])), to="probability")
    put(path, graph.model(tcn.length, tcn.cells))


class _Graph:
    """ONNX graph under construction; methods add nodes and return the name of their output."""

    def __init__(self) -> None:
        import onnx

        self._onnx: Any = onnx
        self._nodes, self._constants = list[Any](), list[Any]()

    def constant(self, values: NDArray[Any]) -> str:
        self._constants.append(self._onnx.numpy_helper.from_array(values, f"constant{len(self._constants)}"))
        return str(self._constants[-1].name)

    def node(self, operator: str, *inputs: str, to: str = "", **attributes: Sequence[int] | int) -> str:
        to = to or f"{operator.lower()}{len(self._nodes)}"
        self._nodes.append(self._onnx.helper.make_node(operator, inputs, [to], **attributes))
        return to

    def sliced(self, x: str, begin: int, end: int = np.iinfo(np.int64).max) -> str:
        """Return the steps of `x` (n, channels, steps) from `begin` to before `end`."""
        return self.node("Slice", x, *(self.constant(np.array([each])) for each in (begin, end, 2)))

    def features(self, tcn: Tcn) -> str:
        """Return the features (n, 2 cells, length - 1) of the input."""
        counts = self.node("Transpose", "counts", perm=(0, 2, 1))
        newer, older = self.sliced(counts, 1), self.sliced(counts, 0, -1)
        scaled = [
            self.node("Asinh", self.node("Div", value, self.constant(np.array(scale, np.float32))))
            for value, scale in (
                (newer, tcn.position_scale),
                (self.node("Sub", newer, older), tcn.step_scale),
            )
        ]
        return self.node("Concat", *scaled, axis=1)

    def convolved(self, x: str, layer: CausalLayer, *, activated: bool = True) -> str:
        kernel = self.constant(np.ascontiguousarray(layer.kernel.transpose(2, 1, 0)))
        y = self.node("Conv", x, kernel, self.constant(layer.bias), dilations=[layer.dilation])
        return self.node("Relu", y) if activated else y

    def model(self, length: int, cells: int) -> bytes:
        """Return the content of the file."""
        helper, number = self._onnx.helper, self._onnx.TensorProto.FLOAT
        counts = helper.make_tensor_value_info("counts", number, ["n", length, cells])
        probability = helper.make_tensor_value_info("probability", number, ["n"])
        graph = helper.make_graph(self._nodes, "tcn", [counts], [probability], self._constants)
        opset = helper.make_opsetid("", OPSET)
        content: bytes = helper.make_model(
            graph, opset_imports=[opset], ir_version=_IR_VERSION, producer_name="slipflow"
        ).SerializeToString()
        return content


def _past(layer: CausalLayer) -> int:
    """Return the number of samples before the newest that a convolution reads."""
    return int((len(layer.kernel) - 1) * layer.dilation)
