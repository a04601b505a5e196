from typing import Any, TypeAlias

import numpy as np
import pytest
import torch
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from torch.nn.functional import conv1d, pad

from operators import InputError, ParameterError, Score, Zeroed
from operators.batch import Counts, Reals
from operators.detectors import Tcn
from operators.detectors.tcn import shapes

Arrays: TypeAlias = dict[str, NDArray[Any]]
Size: TypeAlias = tuple[int, int, int, tuple[int, ...]]  # taps, filters, units, dilations

SMALL: Size = (3, 5, 4, (1, 3))
SIZES: list[Size] = [
    (8, 16, 24, (1, 2, 4)),
    (8, 12, 24, (1, 2, 4)),  # as many filters as features: the first block has a skip too
    (3, 33, 7, (4, 3, 1)),
    (2, 1, 3, (5,)),
    (1, 4, 3, (1, 2)),
]
sized = pytest.mark.parametrize("size", SIZES, ids=str)


def _weights(size: Size = SMALL, seed: int = 0) -> Arrays:
    rng = np.random.default_rng(seed)
    taps, filters, units, dilations = size
    weights: Arrays = {}
    for name, shape in shapes(taps, filters, units, len(dilations)).items():
        spread = 1.2 / np.sqrt(np.prod(shape[:-1])) if name.endswith("kernel") else 0.3
        weights[name] = (rng.normal(size=shape) * spread).astype(np.float32)
    scales = {"position_scale": np.full(1, 8, np.float32), "step_scale": np.full(1, 1.5, np.float32)}
    return weights | scales | {"dilations": np.array(dilations)}


def _counts(rows: int) -> Counts:
    """Return counts of a fingertip that is pressed, dragged and released."""
    rng = np.random.default_rng(1)
    shape = (rows, 6)
    load = np.repeat(rng.integers(-500, 50, (rows // 40 + 1, 6)), 40, axis=0)[:rows]
    counts: Counts = (load + rng.normal(size=shape) * rng.choice([1, 30], shape)).astype(np.int16)
    return counts


def _windows(counts: Counts, length: int) -> Counts:
    """(n - length + 1, length, 6)"""
    return sliding_window_view(counts, length, axis=0).swapaxes(1, 2)


def _streamed(tcn: Tcn, counts: Counts) -> Reals:
    """(n - length + 1,)"""
    touch = Zeroed(np.arange(len(counts)), counts, counts, np.ones_like(counts, np.bool_))
    return Score(tcn).push(touch).probability


def _reference(weights: Arrays, counts: Counts) -> Reals:
    """The network over a whole recording (n, 6) in torch, each convolution padded with zeros before; (n,)."""
    tensors = {name: torch.tensor(array).double() for name, array in weights.items()}
    readings = torch.tensor(counts.T).double()[None]  # (1, 6, n)
    steps = torch.diff(readings, prepend=readings[..., :1])
    inputs = readings / tensors["position_scale"], steps / tensors["step_scale"]
    values = torch.asinh(torch.cat(inputs, dim=1))  # (1, 12, n)

    def layer(inputs: torch.Tensor, name: str, dilation: int = 1) -> torch.Tensor:
        kernel = tensors[f"{name}/kernel"]
        kernel = (kernel if kernel.ndim == 3 else kernel[None]).permute(2, 1, 0)  # (out, in, taps)
        padded = pad(inputs, ((kernel.shape[2] - 1) * dilation, 0))
        return conv1d(padded, kernel, tensors[f"{name}/bias"], dilation=dilation)

    for block, dilation in enumerate(weights["dilations"].tolist()):
        inner = layer(values, f"conv{2 * block}", dilation).relu()
        outer = layer(inner, f"conv{2 * block + 1}", dilation).relu()
        values = outer + values if outer.shape == values.shape else outer
    for dense in ("dense0", "dense1"):
        values = layer(values, dense).relu()
    probability: Reals = layer(values, "out").sigmoid()[0, 0].numpy()
    return probability


@sized
def test_streaming_windowed_and_dense_are_the_same_function(size: Size) -> None:
    weights, counts = _weights(size), _counts(400)
    tcn = Tcn(weights)
    expected = _reference(weights, counts)[tcn.length - 1 :]
    assert expected.std() > 0.01
    np.testing.assert_allclose(tcn.score(_windows(counts, tcn.length)), expected, atol=1e-5)
    np.testing.assert_allclose(_streamed(tcn, counts), expected, atol=1e-5)


@sized
def test_the_receptive_field_is_the_window_and_no_sample_more(size: Size) -> None:
    taps, _, _, dilations = size
    tcn, counts = Tcn(_weights(size)), _counts(400)
    assert tcn.length == 2 + 2 * (taps - 1) * sum(dilations)
    each = tcn.length + 1
    sequences = _windows(counts, each)
    newest = _streamed(tcn, sequences.reshape(-1, 6))[1::each]
    changed = {}
    for sample in (0, 1, tcn.length):
        other = sequences.copy()
        other[:, sample] += 400
        changed[sample] = (newest != _streamed(tcn, other.reshape(-1, 6))[1::each]).any()
    assert changed == {0: False, 1: True, tcn.length: True}


def test_counts_beyond_10_bits_are_judged_as_in_windows() -> None:
    tcn, counts = Tcn(_weights()), _counts(60)
    counts[10:16, 2] = 2046, -2046, 2047, -2047, 32767, -32768
    expected = tcn.score(_windows(counts, tcn.length))
    np.testing.assert_allclose(_streamed(tcn, counts), expected, atol=1e-5)


def test_a_fingertip_with_another_number_of_cells_is_refused() -> None:
    with pytest.raises(ParameterError, match="Tcn: cells is 5, must be 6, as in training"):
        _streamed(Tcn(_weights()), _counts(60)[:, :5])


@pytest.mark.parametrize("name", sorted(set(_weights()) - {"dilations"}))
def test_an_array_of_another_shape_or_that_is_not_finite_is_named(name: str) -> None:
    for value in (np.nan, np.inf):
        with pytest.raises(InputError, match=f"^Tcn weights: {name} is not finite$"):
            Tcn(_weights() | {name: np.full_like(_weights()[name], value)})
    with pytest.raises(InputError, match=r"^Tcn weights: .* has shape .*, must be \("):
        Tcn(_weights() | {name: np.ones((3, 2, 1, 1))})
    with pytest.raises(InputError, match=f"^Tcn weights: {name} has shape"):
        Tcn(_weights() | {name: np.ones(0)})


@pytest.mark.parametrize("dilations", [[1.0, 3.0], [1, 0], [1, -3], [1, 1001], []])
def test_dilations_that_are_no_whole_numbers_in_range_are_refused(dilations: list[float]) -> None:
    with pytest.raises(InputError, match="must be whole numbers from 1 to 1000"):
        Tcn(_weights() | {"dilations": np.array(dilations)})


def test_a_convolution_that_belongs_to_no_block_is_refused() -> None:
    with pytest.raises(InputError, match="conv2/kernel is not expected: dilations has length 1"):
        Tcn(_weights() | {"dilations": np.array([1])})


@pytest.mark.parametrize("name", ["position_scale", "step_scale"])
@pytest.mark.parametrize("scale", [0, -1])
def test_a_scale_that_is_not_above_0_is_refused(name: str, scale: float) -> None:
    with pytest.raises(InputError, match=f"{name} is {scale}.*, must be above 0"):
        Tcn(_weights() | {name: np.array([scale], np.float32)})
