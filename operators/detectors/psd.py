"""Slip as vibration: the power of the counts above a frequency."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Self

import numpy as np

from operators.batch import SLIP, STATIC, Codes, Counts, Reals
from operators.errors import ParameterError


@dataclass(frozen=True)
class Psd:
    """The PSD threshold that the paper compares with: slip is `threshold` power or more above `cutoff`.

    With x the window less its mean, w Hann weights and X the DFT of w x, the power of one barometer is the
    sum of |X|^2 / (N sum w^2) over the bins above `cutoff`, of both signs, in counts^2; over all bins it
    is the weighted variance. The barometers' powers add up. The probability is power / (power + threshold).

    The paper's 1-s windows mix slip and static, and separate the two hardly better than chance; 0.25 s do.
    Defaults follow from real signals: arm vibration reaches 12 Hz and moves loaded cells by 6 to 15 counts
    a sample, stick-slip is strongest at 14 to 20 Hz and moves them by 25 to 50. Materials that stick and
    slip more slowly need a lower `cutoff`, and `fitted` finds the threshold for labelled windows.

    Raises:
        ParameterError: on a value that cannot be used, such as a `cutoff` beyond the highest bin.
    """

    length: int = 25  # samples
    cutoff: float = 10.0  # Hz
    threshold: float = 1000.0  # counts^2
    rate: float = 100.0  # Hz, of the samples
    name = "psd"

    def __post_init__(self) -> None:
        if self.length < 2:  # noqa: PLR2004 one sample has no spectrum
            raise ParameterError("Psd", "length", self.length, "at least 2 samples")
        highest = self.length // 2 / self.length * self.rate
        if not 0 <= self.cutoff < highest:
            raise ParameterError(
                "Psd", "cutoff", self.cutoff, f"from 0 to below {highest:g} Hz, the highest bin"
            )
        if not self.threshold > 0:
            raise ParameterError("Psd", "threshold", self.threshold, "above 0")
        _transform(self.length, self.cutoff / self.rate)  # the first score must not wait for it

    def score(self, windows: Counts | Reals) -> Reals:
        """The probability of slip of each window (n, length, 6); (n,)."""
        power = self.power(windows)
        return power / (power + self.threshold)

    def power(self, windows: Counts | Reals) -> Reals:
        """The power above the cutoff of each window (n, length, 6); (n,) counts^2."""
        spectrum = _transform(self.length, self.cutoff / self.rate) @ windows.astype(np.float64, order="C")
        power: Reals = np.square(spectrum).reshape(len(windows), -1).sum(axis=1)
        return power

    def fitted(self, windows: Counts | Reals, labels: Codes) -> Self:
        """The same with the threshold of the best balanced accuracy on windows with labels (n,).

        Raises:
            ParameterError: if none of them is slip, or none static.
        """
        power = self.power(windows)
        slip, static = np.sort(power[labels == SLIP]), np.sort(power[labels == STATIC])
        if not len(slip) or not len(static):
            raise ParameterError(
                "Psd", "labels", sorted(set(labels.tolist())), "of slip and of static windows"
            )
        passed, missed = static.searchsorted(power) / len(static), slip.searchsorted(power) / len(slip)
        return replace(self, threshold=float(power[np.argmax(passed - missed)]))


@cache
def _transform(length: int, cutoff: float) -> Reals:
    """What takes a window (length, 6) to the scaled real and imaginary parts of its bins (2 bins, 6).

    One matrix removes the mean, weights and transforms; at these lengths that is faster than an FFT of each
    window, and rounds a window alike whatever stands beside it.
    """
    from scipy.fft import rfft, rfftfreq  # noqa: PLC0415 - takes 0.6 s to import

    weights = np.hanning(length + 2)[1:-1]  # none of them 0: the newest sample counts
    frequency = rfftfreq(length)  # of the sample rate
    above = frequency > cutoff
    signs = np.where(frequency == 1 / 2, 1, 2)[above]  # the Nyquist bin has one
    spectrum = rfft(np.diag(weights), axis=0)[above]  # (bins, length)
    spectrum *= np.sqrt(signs / (length * np.square(weights).sum()))[:, None]
    parts: Reals = np.concatenate((spectrum.real, spectrum.imag))
    parts -= parts.mean(axis=1, keepdims=True)
    return parts
