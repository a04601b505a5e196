"""Weights of detectors: named arrays, checked before use."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

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
    """Base of detectors whose weights were trained on data of one fingertip.

    Attributes:
        fingertip: Cells, rate and unit of that data.
        model: Name or file of the weights; empty: unknown.
        purpose: Name of the model and what it is meant for; empty: unknown.
    """

    name: str
    fingertip: Fingertip = TAKKTILE
    model: str = ""
    purpose: str = ""

    def check_fingertip(self, given: Fingertip) -> None:
        """Check that data of the fingertip `given` is like that in training.

        Raises:
            FingertipError: if it is not; it names the operators that convert it.
        """
        self.fingertip.check_fits(self.model or self.name, given)


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
