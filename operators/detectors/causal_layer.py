"""Layer of a causal convolutional network."""

from dataclasses import dataclass

from operators.detectors.weights import Floats


@dataclass(frozen=True, eq=False)
class CausalLayer:
    """Causal convolution over past steps; a dense layer has a single tap."""

    kernel: Floats  # (taps, inputs, outputs), the oldest tap first
    bias: Floats  # (outputs,)
    dilation: int = 1  # steps between taps
    skip: bool = False  # add the input of the previous layer after the ReLU
