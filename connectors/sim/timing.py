"""When a stream samples the world, and how it stamps what it saw."""

from typing import Final

import numpy as np

from connectors.sim.scene import Timing
from operators.batch import Flags, Reals, Times, s

_BEGINNING: Final = int(np.iinfo(np.int64).min)


class Sampler:
    """Counts the samples of one stream."""

    def __init__(self, timing: Timing, random: np.random.Generator) -> None:
        self.timing = timing
        self._jitter, self._loss = random.spawn(2)
        self._taken = 0
        self._newest = _BEGINNING  # ns

    def instants(self, samples: int) -> Reals:
        """True instants (k,) (s since the run began) of the next samples."""
        return np.arange(self._taken, self._taken + samples) / self.timing.rate

    def stamp(self, samples: int) -> tuple[Times, Flags]:
        """Take the next samples: their stamps (k,) (ns since the run began), and which of them arrive."""
        t, timing = self.instants(samples), self.timing
        self._taken += samples
        stamps = t + timing.latency + timing.offset + timing.drift * t
        arrive = np.ones(samples, np.bool_)
        if timing.jitter:
            stamps += timing.jitter * self._jitter.standard_normal(samples)
        if timing.dropped:
            arrive = self._loss.random(samples) >= timing.dropped
        time = np.maximum.accumulate(np.maximum(np.rint(stamps * s).astype(np.int64), self._newest))
        self._newest = int(time[-1])
        return time, arrive
