"""Check of the rate at which a device sends, for `slipflow doctor`."""

from typing import Final

import numpy as np

from operators.batch import Times, s
from operators.ports import Finding

DIAGNOSIS: Final = 1 * s  # ns, duration of a measurement
_RATE_OFF: Final = 0.05  # largest share by which a measured rate may differ


def rate_finding(subject: str, time: Times, stated: float, remedy: str) -> Finding:
    """Compare the rate of rows with times (n,), ns, with the stated one, Hz."""
    span = float(np.ptp(time)) / s if len(time) else 0.0
    rate = (len(time) - 1) / span if span else 0.0
    text, off = f"{rate:.1f} rows per second of {stated:g}", abs(rate / stated - 1) > _RATE_OFF
    return Finding(subject, f"{text}: {remedy}" if off else text, "bad" if off else "good")
