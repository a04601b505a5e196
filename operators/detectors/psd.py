"""PSD detector: slip as vibration above a frequency."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Self

import numpy as np

from operators.batch import SLIP, STATIC, Codes, Counts, Reals
from operators.checks import check_above, check_at_least, check_whole
from operators.detectors.weights import ForOneFingertip
from operators.errors import ParameterError
from operators.fingertip import TAKKTILE, Fingertip


@dataclass(frozen=True)
class Psd(ForOneFingertip):
    """Detect slip as spectral power above a cutoff frequency, the baseline method of the paper.

    With x the window minus its mean, w Hann weights and X the DFT of w x, the power of a barometer is the
    sum of |X|^2 / (N sum w^2) over the bins above `cutoff`, of both signs, in counts^2. Over all bins this
    is the weighted variance. The powers of the barometers are added. The probability is power / (power +
    threshold).

    Windows of 1 s, as in the paper, mix slip and static and are hardly better than chance; windows of 0.25 s
    separate the two. The defaults follow from real signals: arm vibration reaches 12 Hz and changes loaded
    cells by 6 to 15 counts per sample; stick-slip is strongest at 14 to 20 Hz, with 25 to 50 counts.
    Materials with slower stick-slip need a lower `cutoff`; `fitted` finds the threshold for labelled
    windows.

    Args:
        length: Length of a window, samples.
        cutoff: Frequency above which power counts, Hz.
        threshold: Power at probability 0.5, counts^2.
        fingertip: Fingertip that the threshold was fitted to, with the sample rate.

    Raises:
        ParameterError: if a parameter is invalid, such as a `cutoff` above the highest bin.

    References:
        "Under Pressure" (2021).
    """

    length: int = 25
    cutoff: float = 10.0
    threshold: float = 1000.0
    fingertip: Fingertip = TAKKTILE
    name = "psd"

    def __post_init__(self) -> None:
        check_whole("Psd", "length", self.length, 2, "samples")  # one sample has no spectrum
        check_at_least("Psd", "cutoff", self.cutoff, 0, "Hz")
        highest = self.length // 2 / self.length * self.fingertip.rate
        if self.cutoff >= highest:
            raise ParameterError("Psd", "cutoff", self.cutoff, f"below {highest:g} Hz, the highest bin")
        check_above("Psd", "threshold", self.threshold, 0)
        _transform(self.length, self.cutoff / self.fingertip.rate)  # compute it before the first score

    def for_fingertip(self, given: Fingertip) -> Self:
        """Return the detector with the threshold relative to the range of a fingertip, of any cells.

        Raises:
            FingertipError: if rate or unit differ; it names the operators that convert them.
        """
        replace(self.fingertip, layout=given.layout, range=None).check_fits(self.name, given)
        threshold = self.threshold * self.fingertip.ratio(given) ** 2
        return replace(self, threshold=threshold, fingertip=replace(given, rate=self.fingertip.rate))

    def score(self, windows: Counts | Reals) -> Reals:
        """Return the probability of slip of each window (n, length, cells); (n,)."""
        power = self.power(windows)
        return power / (power + self.threshold)

    def power(self, windows: Counts | Reals) -> Reals:
        """Return the power above the cutoff of each window (n, length, cells); (n,) counts^2."""
        spectrum = _transform(self.length, self.cutoff / self.fingertip.rate) @ windows.astype(
            np.float64, order="C"
        )
        power: Reals = np.square(spectrum).reshape(len(windows), -1).sum(axis=1)
        return power

    def fitted(self, windows: Counts | Reals, labels: Codes) -> Self:
        """Return a copy with the threshold of best balanced accuracy on windows with labels (n,).

        Raises:
            ParameterError: if there are no slip windows, or no static ones.
        """
        power = self.power(windows)
        slip, static = np.sort(power[labels == SLIP]), np.sort(power[labels == STATIC])
        if not len(slip) or not len(static):
            raise ParameterError("Psd", "labels", sorted(set(labels.tolist())), "both slip and static")
        specificity, missed = static.searchsorted(power) / len(static), slip.searchsorted(power) / len(slip)
        return replace(self, threshold=float(power[np.argmax(specificity - missed)]))


@cache
def _transform(length: int, cutoff: float) -> Reals:
    """Return the matrix (2 bins, length) from a window to scaled real and imaginary parts of its bins.

    It removes the mean, applies the weights and transforms. At these lengths it is faster than an FFT, and
    the rounding of a window does not depend on other windows.
    """
    weights = np.hanning(length + 2)[1:-1]  # without zeros: the newest sample counts
    frequency = np.fft.rfftfreq(length)  # relative to the sample rate
    above = frequency > cutoff
    signs = np.where(frequency == 1 / 2, 1, 2)[above]  # the Nyquist bin has one sign
    spectrum = np.fft.rfft(np.diag(weights), axis=0)[above]  # (bins, length)
    spectrum *= np.sqrt(signs / (length * np.square(weights).sum()))[:, None]
    parts: Reals = np.concatenate((spectrum.real, spectrum.imag))
    parts -= parts.mean(axis=1, keepdims=True)
    return parts
