"""How a detector is trained densely: every sample of a sequence is a training label."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from operators.errors import ParameterError

LONGEST: Final = 100  # samples that an answer may depend on: those of a window


@dataclass(frozen=True, slots=True)
class Augmentation:
    """What is done to counts so that a detector bears what recordings do not show.

    Each is done to a crop with its chance, in this order; a chance of 0 leaves it out. Labels stay.
    """

    flip: float = 0.5  # chance of the mirror along x, and of that along y: the pad's symmetry group
    gain: float = 0.5  # chance
    gain_spread: float = 0.25  # of the logarithm of the pad's gain; of each cell's, 0.8 of that
    load: float = 0.3  # chance of a slow change of load, 0.1 to 2 Hz, different in each cell
    load_amplitude: float = 20.0  # counts
    noise: float = 0.5  # chance
    noise_range: tuple[float, float] = (0.3, 20.0)  # counts, standard deviation, log-uniform
    dead: float = 0.25  # chance that one cell, or as often two, reads 0


@dataclass(frozen=True, slots=True)
class Recipe:
    """Size of the network and course of its training.

    >>> Recipe().receptive_field
    100

    Raises:
        ParameterError: on a value that cannot be used.
    """

    filters: int = 16
    units: int = 24  # of each of the two dense layers
    taps: int = 8  # of a convolution
    dilations: Sequence[int] = (1, 2, 4)  # of the blocks, two convolutions each
    dropout: float = 0.1  # of whole channels, behind each block
    position_scale: float = 60.0  # counts; see `DenseTcn`
    step_scale: float = 6.0  # counts
    steps: int = 4000  # of the optimiser
    batch: int = 32  # crops
    crop: int = 612  # samples, of which all but the first `receptive_field` - 1 are labels
    rate: float = 5e-3  # of AdamW, at its peak
    decay: float = 1e-2  # of AdamW
    warm_up: float = 0.1  # of the steps; a cosine follows
    checks: int = 20  # on the validation split
    patience: int = 8  # checks without a better score after which training ends
    seed: int = 0
    augmentation: Augmentation = field(default_factory=Augmentation)

    def __post_init__(self) -> None:
        for name in ("filters", "units", "taps", "steps", "batch", "checks", "patience"):
            if getattr(self, name) < 1:
                raise ParameterError("Recipe", name, getattr(self, name), "at least 1")
        if self.receptive_field > LONGEST:
            reason = f"so few that the receptive field, {self.receptive_field}, is at most {LONGEST} samples"
            raise ParameterError("Recipe", "taps and dilations", (self.taps, *self.dilations), reason)
        if self.crop <= self.receptive_field:
            raise ParameterError("Recipe", "crop", self.crop, f"above {self.receptive_field} samples")

    @property
    def receptive_field(self) -> int:
        """Samples that one answer depends on; the step into the oldest feature adds one."""
        return 2 + 2 * (self.taps - 1) * sum(self.dilations)
