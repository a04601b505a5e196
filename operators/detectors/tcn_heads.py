"""Optional parts of the TCN that read its features: sliding velocity, and familiarity with the input.

The features are the outputs of the last convolution.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from operators.detectors.causal_layer import CausalLayer
from operators.detectors.weights import Floats, Weights, check_weights
from operators.errors import InputError

_VELOCITY: Final = ("velocity0", "velocity1", "velocity")  # names of the layers
_UNITS: Final = 32  # of the layers before the last
_OUTPUTS: Final = 4  # vx, vy, mm/s; natural logarithms of their standard deviations


@dataclass(frozen=True, eq=False)
class Familiarity:
    """Distance of the features, averaged over time, from those of the training data.

    The squared distance is ``sum(((mean features - mean) @ whitening) ** 2)``.
    """

    mean: Floats  # (filters,)
    whitening: Floats  # (filters, filters)
    limit: np.float32  # squared distance above which a sample is doubtful
    samples: np.float32  # time constant of the exponential mean

    @property
    def whitening_layer(self) -> CausalLayer:
        """The whitening as a dense layer."""
        return CausalLayer(self.whitening[None], np.zeros_like(self.mean))


@dataclass(frozen=True, eq=False)
class Heads:
    """Heads of a TCN; empty if its weights have none."""

    velocity: tuple[CausalLayer, ...] = ()  # dense layers
    familiarity: Familiarity | None = None

    def __bool__(self) -> bool:
        return bool(self.velocity) or self.familiarity is not None

    @property
    def weights(self) -> dict[str, Floats]:
        """Arrays, as `read_heads` takes them."""
        arrays = dict[str, Floats]()
        for name, layer in zip(_VELOCITY, self.velocity, strict=False):
            arrays[f"{name}/kernel"], arrays[f"{name}/bias"] = layer.kernel[0], layer.bias
        if (familiar := self.familiarity) is not None:
            arrays["familiar/mean"], arrays["familiar/whitening"] = familiar.mean, familiar.whitening
            arrays["familiar/limit"] = np.array([familiar.limit])
            arrays["familiar/samples"] = np.array([familiar.samples])
        return arrays


def head_shapes(filters: int) -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of both heads."""
    kernels = (filters, _UNITS), (_UNITS, _UNITS), (_UNITS, _OUTPUTS)
    result: dict[str, tuple[int, ...]] = {
        "familiar/mean": (filters,),
        "familiar/whitening": (filters, filters),
        "familiar/limit": (1,),
        "familiar/samples": (1,),
    }
    for name, kernel in zip(_VELOCITY, kernels, strict=True):
        result[f"{name}/kernel"], result[f"{name}/bias"] = kernel, kernel[1:]
    return result


def read_heads(weights: Weights, filters: int) -> Heads:
    """Return the heads among the weights of a TCN.

    Raises:
        InputError: if a head is incomplete, or an array has a wrong shape, is not finite or is out of range.
    """
    groups = [
        {name: shape for name, shape in head_shapes(filters).items() if name.startswith(head)}
        for head in ("velocity", "familiar")
    ]
    has_velocity, has_familiarity = (any(name in weights for name in group) for group in groups)
    if has_velocity:
        check_weights("Tcn", weights, groups[0])
    if has_familiarity:
        check_weights("Tcn", weights, groups[1])
    return Heads(
        _velocity(weights) if has_velocity else (), _familiarity(weights) if has_familiarity else None
    )


def _velocity(weights: Weights) -> tuple[CausalLayer, ...]:
    return tuple(
        CausalLayer(_array(weights, f"{name}/kernel")[None], _array(weights, f"{name}/bias"))
        for name in _VELOCITY
    )


def _familiarity(weights: Weights) -> Familiarity:
    mean, whitening, limit, samples = (
        _array(weights, f"familiar/{name}") for name in ("mean", "whitening", "limit", "samples")
    )
    if not limit[0] > 0:
        raise InputError("Tcn weights", f"familiar/limit is {limit[0]}, must be above 0")
    if not samples[0] >= 1:
        raise InputError("Tcn weights", f"familiar/samples is {samples[0]}, must be at least 1")
    return Familiarity(mean, whitening, limit[0], samples[0])


def _array(weights: Weights, name: str) -> Floats:
    return weights[name].astype(np.float32)
