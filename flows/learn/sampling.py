"""Constant rate of a recording's samples: conversions between samples, decisions and time."""

from dataclasses import dataclass
from math import isclose
from typing import Final, Self

import numpy as np

from operators import Debounce, s
from operators.batch import Times

WARM_UP: Final = 99  # samples; the longest window of the detectors has 100
_RATE: Final = 100.0  # Hz, that settings of a debounce and features are written for
_MEASURED: Final = 1e-3  # largest relative error of a measured rate


@dataclass(frozen=True, slots=True)
class Sampling:
    """Constant rate of samples.

    >>> Sampling(200.0).period, Sampling(200.0).warm_up, Sampling(200.0).scaled(2)
    (5000000, 199, 4)
    """

    rate: float = _RATE  # Hz

    @classmethod
    def measured(cls, rate: float) -> Self:
        """Return the sampling at a measured rate, Hz; 0.1 % from a whole number it is that number.

        >>> Sampling.measured(99.99)
        Sampling(rate=100.0)
        """
        whole = float(round(rate))
        return cls(whole if isclose(rate, whole, rel_tol=_MEASURED) else rate)

    @property
    def period(self) -> int:
        """Time from one sample to the next, ns."""
        return round(s / self.rate)

    @property
    def warm_up(self) -> int:
        """Samples at the start that are not evaluated: no window of 1 s and of 100 samples is filled yet."""
        return max(round(self.rate) - 1, WARM_UP)

    def samples(self, time: float) -> int:
        """Return the number of samples in a time (ns), at least 1."""
        return max(round(time * self.rate / s), 1)

    def times(self, samples: int) -> Times:
        """Return the times of consecutive samples, ns from the first one; (samples,)."""
        return np.arange(samples) * self.period

    def minutes(self, samples: int) -> float:
        """Return the duration of a number of samples."""
        return samples * self.period / (60 * s)

    def scaled(self, usual: int) -> int:
        """Return the number of samples that last as long as `usual` ones at 100 Hz; below 100 Hz `usual`."""
        return round(usual * max(self.rate / _RATE, 1))

    def rule(self, usual: Debounce) -> Debounce:
        """Return a debounce that takes as long as `usual` does at 100 Hz; below 100 Hz as many decisions."""
        return Debounce(
            usual.threshold, self.scaled(usual.consecutive), self.scaled(usual.release), usual.minimum
        )


USUAL: Final = Sampling()
