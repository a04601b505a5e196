"""Streaming inference of the TCN: cached causal convolutions, compiled with numba.

A layer with dilation d reads every d-th of its inputs. They are stored in d interleaved rings, each value
twice, `taps` slots apart. So the inputs of the taps are always contiguous, oldest first, and a layer is one
product of a matrix and a vector, computed four outputs at a time: each input is loaded once for the four.
Layers are padded with zeros to a multiple of four outputs. A ring of 4 taps after the inputs 0 to 5::

    4 5 2 3 4 5 2 3       the newest, 5, is in slots 1 and 5; the inputs 2 3 4 5 start after the first

Before the first sample, the inputs of all layers are 0, as if the recording were zero-padded before each
convolution, and the first step is 0. This has no effect after as many samples as a window has.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from operators.compilation import compile_function
from operators.detectors.weights import CausalLayer, Floats
from operators.steps import Record, Steps

_LAYER: Final = np.dtype(
    [
        ("taps", np.int64),
        ("channels", np.int64),  # of the input
        ("dilation", np.int64),
        ("rings", np.int64),  # where those of the input begin in the memory
        ("kernel", np.int64),  # where (outputs, taps, channels) begins in the weights; the bias follows
        ("skip", np.int64),  # 1: the input of the previous layer is added
    ]
)
_TOGETHER: Final = 4  # outputs that are computed together
_TABLE: Final = 2046  # largest step of a 10-bit count; asinh of whole numbers up to it is tabulated


def tcn_steps(
    layers: Sequence[CausalLayer], position_scale: np.float32, step_scale: np.float32, length: int
) -> Steps:
    """Return the step of a TCN from zeroed touch to scores, from the `length`-th sample on.

    Invalid cells take their last valid counts, or 0 before the first. If more than half of the cells are
    invalid, the score is NaN.
    """
    size, channels = 0, 0  # of the memory; of a layer's output
    rows, weights = list[tuple[int, ...]](), list[Floats]()
    for layer in layers:
        taps, inputs, outputs = layer.kernel.shape
        reads, channels = (count + -count % _TOGETHER for count in (inputs, outputs))
        kernel, bias = np.zeros((taps, reads, channels), np.float32), np.zeros(channels, np.float32)
        kernel[:, :inputs, :outputs], bias[:outputs] = layer.kernel, layer.bias
        rows.append((taps, reads, layer.dilation, size, sum(map(len, weights)), layer.skip))
        weights += [kernel.transpose(2, 0, 1).ravel(), bias]
        size += layer.dilation * 2 * taps * reads
    rows.append((1, channels, 1, size, 0, 0))  # the logit
    whole = np.arange(-_TABLE, _TABLE + 1, dtype=np.float32)
    return Steps(
        settings={
            "layers": np.array(rows, _LAYER),
            "weights": np.concatenate(weights),
            "position_scale": position_scale,
            "step_scale": step_scale,
            "positions": np.arcsinh(whole / position_scale),
            "changes": np.arcsinh(whole / step_scale),
            "length": length,
        },
        state={
            "counts": np.zeros(layers[0].kernel.shape[1] // 2, np.int16),  # last valid
            "memory": np.zeros(size + 2 * channels, np.float32),  # rings of each layer
            "seen": 0,  # samples
        },
        step=_score,
    )


def _score(settings: Record, state: Record, row: Record, out: Record) -> bool:
    valid = _enter(settings, state, row)
    probability = _advance(settings, state)
    state.seen += 1
    if state.seen < settings.length:
        return False
    out.time = row.time
    out.probability = math.nan if 2 * valid < len(state.counts) else probability
    return True


def _enter(settings: Record, state: Record, row: Record) -> int:
    """Store the position and step of each cell for the first layer; return the number of valid cells."""
    layer, counts, memory, valid = settings.layers[0], state.counts, state.memory, 0
    cells, new = len(counts), _slot(layer, state.seen)
    again = new + layer.taps * layer.channels
    for cell in range(cells):
        count = previous = counts[cell]
        if row.valid[cell]:
            count = counts[cell] = row.counts[cell]
            valid += 1
        step = count - previous if state.seen else 0
        memory[new + cell] = memory[again + cell] = _asinh(count, settings.positions, settings.position_scale)
        value = _asinh(step, settings.changes, settings.step_scale)
        memory[new + cells + cell] = memory[again + cells + cell] = value
    return valid


def _advance(settings: Record, state: Record) -> float:
    """Compute all layers for the newest sample and return the probability of slip."""
    layers, weights, memory, last = settings.layers, settings.weights, state.memory, len(settings.layers) - 1
    old = new = _slot(layers[0], state.seen)
    for number in range(last):
        layer, following = layers[number], layers[number + 1]
        older, old, new = old, new, _slot(following, state.seen)
        outputs, reach = following.channels, layer.taps * layer.channels
        again, bias = new + following.taps * outputs, layer.kernel + outputs * reach
        least = np.float32(0 if number + 1 < last else -np.inf)
        run = memory[old + layer.channels : old + layer.channels + reach]
        for output in range(0, outputs, _TOGETHER):
            row = layer.kernel + output * reach
            four = _products(
                weights[row : row + reach],
                weights[row + reach : row + 2 * reach],
                weights[row + 2 * reach : row + 3 * reach],
                weights[row + 3 * reach : row + 4 * reach],
                run,
            )
            for i in range(_TOGETHER):
                value = max(four[i] + weights[bias + output + i], least)
                if layer.skip:
                    value += memory[older + output + i]
                memory[new + output + i] = memory[again + output + i] = value
    return 1 / (1 + math.exp(-np.float64(memory[new])))


def _slot(layer: Record, time: int) -> int:
    """Return the memory slot of a layer's input at a time; its copy is taps * channels later."""
    slot = time % layer.dilation * 2 * layer.taps + time // layer.dilation % layer.taps
    return int(layer.rings + slot * layer.channels)


def _asinh(count: int, table: Floats, scale: np.float32) -> float:
    """Return asinh(count / scale), which takes ten times as long if it is not in the table."""
    if -_TABLE <= count <= _TABLE:
        return float(table[_TABLE + count])
    return math.asinh(np.float32(count) / scale)


@compile_function(fastmath={"reassoc", "contract", "nsz"})  # sums in any order
def _products(a: Floats, b: Floats, c: Floats, d: Floats, run: Floats) -> tuple[np.float32, ...]:
    """Return the dot products of four rows of a kernel with the inputs."""
    w = x = y = z = np.float32(0)
    for i in range(len(run)):
        value = run[i]
        w += a[i] * value
        x += b[i] * value
        y += c[i] * value
        z += d[i] * value
    return w, x, y, z
