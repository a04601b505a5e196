"""Upper confidence limit of a number of false alarms, for alarms that come in clusters."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainccinv, ndtri, stdtrit

from operators.batch import Reals
from operators.errors import SlipflowError


class TooLittleDataError(SlipflowError):
    """Too little static time to show that a rate of false alarms is kept, even by the strictest setting."""

    def __init__(self, rate: float, confidence: float, alarms: int, minutes: float, needed: float) -> None:
        had = f"{alarms} false alarm{'' if alarms == 1 else 's'}" if alarms else "no false alarm"
        found = f"the strictest setting had {had} in {minutes:.1f} static minutes"
        if alarms > rate * minutes:
            advice = (
                f", {alarms / minutes:.2g} per minute, so more data will not help;"
                " allow a higher rate, or train the model for such recordings"
            )
        else:
            more = f"{needed - minutes:.1f} more static minutes{' without a further one' if alarms else ''}"
            advice = f", but {needed:.1f} are needed; record {more}, or allow a higher rate"
        super().__init__(
            f"a rate of {rate:g} false alarms per minute cannot be shown with {100 * confidence:g} %"
            f" confidence: {found}{advice}"
        )
        self.minutes, self.needed = minutes, needed


def alarm_limit(alarms: NDArray[np.int64], minutes: Reals, confidence: float) -> float:
    """Return the upper confidence limit of the expected number of false alarms in all these minutes.

    Alarms in one session resemble each other: a session of a rough surface has many. So sessions, or all
    sessions of a surface, are the exchangeable units, not samples. The limit is that of a Poisson count,
    after count and time have been divided by the design effect, the factor by which the variance over units
    exceeds that of a Poisson process [1]. The effect is at least 1, and enlarged by a quotient of quantiles
    of the t and the normal distribution because it is estimated from few units.

    Without clusters the limit is exact or conservative: for units that have at most one alarm each, with any
    probabilities, because such a sum is rarer far below its mean than a Poisson count [2]; and for Poisson
    counts. For clustered alarms it is an approximation. No limit can exclude a unit with very many alarms
    that none of the given ones resembles. Without any alarm it is -ln(1 - confidence): 3.0 at 95 %.

    Args:
        alarms: (n,) false alarms of each unit.
        minutes: (n,) static minutes of each unit.
        confidence: Probability that the expected number is at most the limit, above 0.5, below 1.

    >>> round(alarm_limit(np.zeros(5, np.int64), np.ones(5), 0.95), 3)
    2.996
    >>> round(alarm_limit(np.ones(5, np.int64), np.ones(5), 0.95), 2)
    10.51
    >>> round(alarm_limit(np.array([5, 0, 0, 0, 0]), np.ones(5), 0.95), 2)
    34.2

    References:
        [1] Korn and Graubard, "Confidence intervals for proportions with small expected number of positive
        counts estimated from survey data", Survey Methodology 24 (1998).
        [2] Hoeffding, "On the distribution of the number of successes in independent trials" (1956); Anderson
        and Samuels, "Some inequalities among binomial and Poisson probabilities" (1967).
    """
    count = int(alarms.sum())
    effect = _design_effect(alarms, minutes)
    if effect > 1:
        effect *= float(stdtrit(len(alarms) - 1, confidence) / ndtri(confidence)) ** 2
    return effect * float(gammainccinv(count / effect + 1, 1 - confidence))


def _design_effect(alarms: NDArray[np.int64], minutes: Reals) -> float:
    """Return the variance of the number of alarms over units relative to a Poisson count, at least 1."""
    count, size = int(alarms.sum()), len(alarms)
    if size < 2 or count < 2:
        return 1.0
    residuals = alarms - count * minutes / minutes.sum()
    return max(float((residuals**2).sum()) * size / (size - 1) / count, 1.0)
