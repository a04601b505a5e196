"""Our network as an ONNX file, for runtimes that have no Python."""

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from operators.batch import BAROMETERS
from operators.detectors import Tcn
from operators.errors import InputError
from storage.files import put

OPSET: Final = 17
_VERSION: Final = 8  # of the file format, which goes with that set of operators


def export(arrays: Mapping[str, NDArray[Any]], path: Path) -> None:
    """Write the network: input ``counts`` (n, length, 6) float32, zeroed; output ``probability`` (n,).

    Args:
        arrays: As `operators.detectors.Tcn` takes them.
        path: The file to write.

    Raises:
        InputError: if onnx is not installed, or the arrays are not those of our network.
        OSError: if the file cannot be written.
    """
    if find_spec("onnx") is None:
        raise InputError("ONNX export", "needs onnx: in the clone, pip install -e '.[train]'")
    import onnx  # noqa: PLC0415 - an extra

    library: Any = onnx  # it declares no types
    length = Tcn(arrays).length
    graph = _Graph(library)
    x = graph.add("Transpose", "counts", perm=[0, 2, 1])  # (n, 6, length)
    now, before = graph.slice(x, 1, length), graph.slice(x, 0, length - 1)  # (n, 6, length - 1)
    positions = graph.add("Asinh", graph.add("Div", now, graph.constant(arrays["position_scale"])))
    steps = graph.add("Sub", now, before)
    steps = graph.add("Asinh", graph.add("Div", steps, graph.constant(arrays["step_scale"])))
    x = graph.add("Concat", positions, steps, axis=1)  # (n, 12, length - 1)
    width = 2 * BAROMETERS
    for block, dilation in enumerate(arrays["dilations"].tolist()):
        y, past = x, 0
        for number in (2 * block, 2 * block + 1):
            kernel = arrays[f"conv{number}/kernel"]  # (taps, in, filters)
            y = graph.convolution(y, kernel, arrays[f"conv{number}/bias"], dilation)
            past += dilation * (len(kernel) - 1)
        if kernel.shape[2] == width:
            y = graph.add("Add", y, graph.slice(x, past, length))
        x, width = y, kernel.shape[2]
    for number in range(2):
        x = graph.convolution(x, arrays[f"dense{number}/kernel"][None], arrays[f"dense{number}/bias"], 1)
    x = graph.convolution(x, arrays["out/kernel"][None], arrays["out/bias"], 1, relu=False)  # (n, 1, 1)
    x = graph.add("Reshape", graph.add("Sigmoid", x), graph.constant(np.array([-1], np.int64)))
    put(path, graph.model(x, length).SerializeToString())


class _Graph:
    """Nodes in order, each named after its place."""

    def __init__(self, library: Any) -> None:  # noqa: ANN401 - onnx declares no types
        self._helper, self._numpy = library.helper, library.numpy_helper
        self._float: int = library.TensorProto.FLOAT
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def add(self, kind: str, *inputs: str, **attributes: Any) -> str:  # noqa: ANN401 - as ONNX has them
        name = f"{kind.lower()}{len(self._nodes)}"
        self._nodes.append(self._helper.make_node(kind, list(inputs), [name], name=name, **attributes))
        return name

    def constant(self, array: NDArray[Any]) -> str:
        name = f"constant{len(self._constants)}"
        self._constants.append(self._numpy.from_array(np.ascontiguousarray(array), name))
        return name

    def slice(self, x: str, start: int, end: int) -> str:
        """The steps of x (n, channels, steps) from one to another."""
        bounds = (self.constant(np.array([bound], np.int64)) for bound in (start, end, 2))
        return self.add("Slice", x, *bounds)

    def convolution(
        self, x: str, kernel: NDArray[Any], bias: NDArray[Any], dilation: int, *, relu: bool = True
    ) -> str:
        """A convolution (taps, in, out) without padding: steps that lack a part of their past fall away."""
        weights = self.constant(kernel.transpose(2, 1, 0))
        y = self.add("Conv", x, weights, self.constant(bias), dilations=[dilation])
        return self.add("Relu", y) if relu else y

    def model(self, output: str, length: int) -> Any:  # noqa: ANN401
        counts = self._helper.make_tensor_value_info("counts", self._float, ["n", length, BAROMETERS])
        probability = self._helper.make_tensor_value_info("probability", self._float, ["n"])
        self._nodes.append(self._helper.make_node("Identity", [output], ["probability"], name="output"))
        graph = self._helper.make_graph(self._nodes, "tcn", [counts], [probability], self._constants)
        opset = self._helper.make_opsetid("", OPSET)
        return self._helper.make_model(
            graph, opset_imports=[opset], ir_version=_VERSION, producer_name="slipflow"
        )
