from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from torch.nn.functional import conv1d, pad

from operators import InputError, ParameterError
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


def _counts(rows: int, fingers: int = 1) -> Counts:
    """Return counts of fingertips that are pressed, dragged and released."""
    rng = np.random.default_rng(1)
    shape = (rows, fingers, 6)
    load = np.repeat(rng.integers(-500, 50, (rows // 40 + 1, fingers, 6)), 40, axis=0)[:rows]
    counts: Counts = (load + rng.normal(size=shape) * rng.choice([1, 30], shape)).astype(np.int16)
    return counts


def _windows(counts: NDArray[Any], length: int) -> Counts:
    """(n - length + 1, length, 6)"""
    return sliding_window_view(counts, length, axis=0).swapaxes(1, 2)


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
    tcn, expected = Tcn(weights), _reference(weights, counts[:, 0])
    judged = slice(tcn.length - 1, None)
    assert expected[judged].std() > 0.01
    streamed = tcn.stream().push(counts)[:, 0]
    np.testing.assert_allclose(tcn.score(_windows(counts[:, 0], tcn.length)), expected[judged], atol=1e-5)
    np.testing.assert_allclose(streamed, expected, atol=1e-5)  # before a window is full, too


@sized
def test_the_receptive_field_is_the_window_and_no_sample_more(size: Size) -> None:
    taps, _, _, dilations = size
    tcn, counts = Tcn(_weights(size)), _counts(400)
    assert tcn.length == 2 + 2 * (taps - 1) * sum(dilations)
    sequences = sliding_window_view(counts[:, 0], tcn.length + 1, axis=0).transpose(2, 0, 1)
    changed = {}
    for sample in (0, 1, tcn.length):
        other = sequences.copy()
        other[sample] += 400
        newest = [tcn.stream(other.shape[1]).push(values)[-1] for values in (sequences, other)]
        changed[sample] = (newest[0] != newest[1]).any()
    assert changed == {0: False, 1: True, tcn.length: True}


def test_fingertips_are_scored_independently() -> None:
    tcn, counts = Tcn(_weights(SIZES[0])), _counts(200, fingers=7)
    together = tcn.stream(7).push(counts)
    alone = [tcn.stream().push(counts[:, [finger]]) for finger in range(7)]
    np.testing.assert_array_equal(together, np.concatenate(alone, axis=1))
    assert np.ptp(together, axis=1).max() > 0.01


@given(cuts=st.lists(st.integers(0, 120), max_size=8), fingers=st.sampled_from([1, 3]))
def test_however_the_samples_are_cut_the_bits_are_the_same(cuts: list[int], fingers: int) -> None:
    tcn, counts = Tcn(_weights()), _counts(120, fingers)
    stream = tcn.stream(fingers)
    pieces = [stream.push(counts[start:stop]) for start, stop in pairwise([0, *sorted(cuts), 120])]
    np.testing.assert_array_equal(np.concatenate(pieces), tcn.stream(fingers).push(counts))


def test_counts_may_be_reals_read_only_or_strided() -> None:
    tcn, counts = Tcn(_weights()), _counts(120, fingers=2)
    expected = tcn.stream(2).push(counts)
    readonly, wide = counts.copy(), np.repeat(counts, 2, axis=1)
    readonly.flags.writeable = False
    for same in (readonly, wide[:, ::2], counts.astype(np.float64)):
        np.testing.assert_array_equal(tcn.stream(2).push(same), expected)


def test_counts_that_are_no_10_bit_integers_are_judged_as_in_windows() -> None:
    tcn, counts = Tcn(_weights()), _counts(60).astype(np.float64)
    counts[10:18, 0, 2] = 2046, -2046, 2047, 1023.5, 0.25, 1e9, -(2.0**63), 1e30
    windows = _windows(counts[:, 0], tcn.length)
    streamed = tcn.stream().push(counts)[tcn.length - 1 :, 0]
    np.testing.assert_allclose(streamed, tcn.score(windows), atol=1e-5)


def test_a_count_that_is_nan_is_not_judged_and_is_forgotten_after_a_window() -> None:
    tcn, counts = Tcn(_weights()), _counts(60).astype(np.float64)
    counts[20, 0, 3] = np.nan
    windows = _windows(counts[:, 0], tcn.length)
    unknown = np.isnan(tcn.stream().push(counts)[:, 0])
    assert np.flatnonzero(unknown)[0] == 20
    assert not unknown[20 + tcn.length :].any()
    np.testing.assert_array_equal(unknown[tcn.length - 1 :], np.isnan(tcn.score(windows)))


def test_input_and_earlier_output_are_not_modified() -> None:
    stream, counts = Tcn(_weights()).stream(), _counts(120)
    copy = counts.copy()
    first = stream.push(counts[:60])
    then = first.copy()
    stream.push(counts[60:])
    np.testing.assert_array_equal(counts, copy)
    np.testing.assert_array_equal(first, then)


def test_counts_of_another_shape_are_refused_and_change_nothing() -> None:
    tcn, counts = Tcn(_weights()), _counts(60, fingers=2)
    stream = tcn.stream(2)
    for wrong in (counts[:, :1], counts[:, 0], counts[:, :, :5]):
        with pytest.raises(ParameterError, match=r"shape of the counts is .*, must be \(n, 2, 6\)"):
            stream.push(wrong)
    np.testing.assert_array_equal(stream.push(counts), tcn.stream(2).push(counts))


def test_arrays_of_an_older_version_are_ignored() -> None:
    older = _weights() | {"velocity/kernel": np.ones((32, 4)), "familiar/limit": np.zeros(1)}
    counts = _counts(60)
    np.testing.assert_array_equal(Tcn(older).stream().push(counts), Tcn(_weights()).stream().push(counts))


@pytest.mark.parametrize("name", sorted(set(_weights()) - {"dilations"}))
def test_an_array_of_another_shape_is_named(name: str) -> None:
    with pytest.raises(InputError, match=r"^Tcn weights: .* has shape .*, must be \("):
        Tcn(_weights() | {name: np.ones((3, 2, 1, 1))})
    with pytest.raises(InputError, match=f"^Tcn weights: {name} has shape"):
        Tcn(_weights() | {name: np.ones(0)})


@pytest.mark.parametrize("dilations", [[1.0, 3.0], [1, 0], [1, -3], [1, 1001]])
def test_dilations_that_are_no_whole_numbers_in_range_are_refused(dilations: list[float]) -> None:
    with pytest.raises(InputError, match="must be whole numbers from 1 to 1000"):
        Tcn(_weights() | {"dilations": np.array(dilations)})


def test_a_convolution_that_belongs_to_no_block_is_refused() -> None:
    with pytest.raises(InputError, match="conv2/kernel is not expected: dilations has length 1"):
        Tcn(_weights() | {"dilations": np.array([1])})
    with pytest.raises(InputError, match="must be whole numbers"):
        Tcn(_weights() | {"dilations": np.zeros(0, np.int64)})


@pytest.mark.parametrize("name", ["position_scale", "step_scale"])
@pytest.mark.parametrize("scale", [0, -1])
def test_a_scale_that_is_not_above_0_is_refused(name: str, scale: float) -> None:
    with pytest.raises(InputError, match=f"{name} is {scale}.*, must be above 0"):
        Tcn(_weights() | {name: np.array([scale], np.float32)})


@sized
def test_a_network_states_the_weights_that_it_was_made_of(size: Size) -> None:
    weights = _weights(size)
    found = Tcn(weights).weights
    assert found.keys() == weights.keys()
    for name, array in weights.items():
        np.testing.assert_array_equal(found[name], array.astype(found[name].dtype))
