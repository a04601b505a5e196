"""Settings of the training of our network and of the paper's."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Final

from operators.checks import check_above

PAPER_NETWORKS: Final = {"frequency_cnn": 6, "paper_tcn": 25}  # epochs in which each improves

STRETCHED: Final = ("wide", "slow", "calm")  # plans with other hands and fingertips than the paper's


@dataclass(frozen=True, slots=True)
class Augmentation:
    """Random changes of counts that make a detector robust to conditions that the recordings lack.

    Each is applied to a crop with its probability, in this order. Only a stretch changes the time of labels.
    """

    flip: float = 0.5  # probability of mirroring along x, and again along y
    gain: float = 0.5  # probability
    gain_spread: float = 0.25  # standard deviation of the log gain of the pad; of each cell 0.8 times that
    load: float = 0.3  # probability of a slow change of load, 0.1 to 2 Hz, different in each cell
    load_amplitude: float = 20.0  # counts
    noise: float = 0.5  # probability
    noise_range: tuple[float, float] = (0.3, 15.0)  # counts, standard deviation, log-uniform
    dead: float = 0.15  # probability that one or two cells, equally often, read 0
    stretch: float = 0.5  # probability of a slower hand, before all others, in plans of `STRETCHED`
    slowest: float = 3.0  # factor of the duration, log-uniform from 1


# for real recordings, which have noise of their own; touch of other surfaces is much weaker or stronger
REAL_TOUCH: Final = Augmentation(
    gain=0.8, gain_spread=0.6, load_amplitude=5.0, noise=0.3, noise_range=(0.3, 3.0), dead=0.1
)

# of the paper: each symmetry of the pad equally often; with the rounding, noise of 0.5 counts
PAPER_TOUCH: Final = Augmentation(gain=0, load=0, noise=1, noise_range=(0.435, 0.435), dead=0)


@dataclass(frozen=True, slots=True)
class Recipe:
    """Size of the network and course of its training.

    >>> Recipe().receptive_field
    212

    Raises:
        ParameterError: if a crop is not longer than the receptive field.
    """

    filters: int = 24
    units: int = 24  # of each of the two dense layers
    taps: int = 8  # of a convolution
    dilations: Sequence[int] = (1, 2, 4, 8)  # of the blocks of two convolutions each
    dropout: float = 0.1  # probability of a whole channel, after each block
    position_scale: float = 60.0  # counts; see `DenseTcn`
    step_scale: float = 6.0  # counts
    steps: int = 6000  # of the optimiser
    batch: int = 48  # crops
    crop: int = 800  # samples: a simulated grasp after a receptive field
    rate: float = 5e-3  # of AdamW, at its peak
    decay: float = 1e-2  # of AdamW
    warm_up: float = 0.1  # of the steps; a cosine follows
    checks: int = 20  # on the validation split
    seed: int = 0
    augmentation: Augmentation = field(default_factory=Augmentation)

    def __post_init__(self) -> None:
        check_above("Recipe", "crop", self.crop, self.receptive_field, "samples")

    @property
    def receptive_field(self) -> int:
        """Samples that one score depends on, with the sample before the oldest feature."""
        return 2 + 2 * (self.taps - 1) * sum(self.dilations)


@dataclass(frozen=True, slots=True)
class PaperRecipe:
    """Settings of the paper's training (its section V): Adam, cross-entropy, `PAPER_TOUCH`.

    Each epoch uses all windows of the smaller class and as many random windows of the other.
    """

    network: str  # one of `PAPER_NETWORKS`
    epochs: int
    rate: float = 0.002  # learning rate
    clip: float = 1.0  # maximum norm of the gradient of one array
    batch: int = 256  # windows
    dropout: float = 0.2  # probability
    seed: int = 0
    receptive_field: ClassVar[int] = 100  # samples of a window
