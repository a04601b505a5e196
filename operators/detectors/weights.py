"""Weights of detectors: named arrays, checked before use."""

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from operators.errors import InputError
from operators.fingertip import TAKKTILE, Fingertip

Floats: TypeAlias = NDArray[np.float32]
Weights: TypeAlias = Mapping[str, NDArray[Any]]
Shapes: TypeAlias = Mapping[str, tuple[int, ...]]


@dataclass(frozen=True, eq=False)
class CausalLayer:
    """Causal convolution over past steps; a dense layer has a single tap."""

    kernel: Floats  # (taps, inputs, outputs), the oldest tap first
    bias: Floats  # (outputs,)
    dilation: int = 1  # steps between taps
    skip: bool = False  # add the input of the previous layer after the ReLU


class ForOneFingertip:
    """Base of detectors that were trained or fitted on data of one fingertip.

    Attributes:
        fingertip: Cells, rate and unit of that data.
        in_counts: Names of the attributes that divide counts or are subtracted from them.
        model: Name or file of the weights; empty: unknown.
    """

    name: str
    in_counts: tuple[str, ...] = ("_mean", "_std")
    fingertip: Fingertip = TAKKTILE
    model: str = ""

    def for_fingertip(self, given: Fingertip) -> Self:
        """Return the detector for data of the fingertip `given`, with inputs relative to its range.

        A count of a converter of 12 bits is a quarter of one of 10 bits. A range that is unknown, or in a
        physical unit such as kPa, changes nothing.

        Raises:
            FingertipError: if the data is not like that in training; it names the operators that convert it.
        """
        self.fingertip.check_fits(self.model or self.name, given)
        ratio, made = self.fingertip.ratio(given), copy(self)
        for name in self.in_counts if ratio != 1 else ():
            value: NDArray[Any] = getattr(self, name)
            setattr(made, name, (value * ratio).astype(value.dtype))
        made.fingertip = given
        return made


def check_weights(owner: str, weights: Weights, shapes: Shapes) -> None:
    """Check that all arrays in `shapes` exist, have these shapes and are finite, and ``std`` is above 0.

    Raises:
        InputError: naming the first invalid array.

    >>> check_weights("Net", {"bias": np.zeros(3)}, {"bias": (2,)})
    Traceback (most recent call last):
    operators.errors.InputError: Net weights: bias has shape (3,), must be (2,)
    """
    for name, shape in shapes.items():
        if name not in weights:
            raise InputError(f"{owner} weights", f"{name} is missing")
        array = weights[name]
        if array.shape != shape:
            raise InputError(f"{owner} weights", f"{name} has shape {array.shape}, must be {shape}")
        if not np.isfinite(array).all():
            raise InputError(f"{owner} weights", f"{name} is not finite")
        if name == "std" and not (array > 0).all():
            raise InputError(f"{owner} weights", f"{name} is {array.min()}, must be above 0")
