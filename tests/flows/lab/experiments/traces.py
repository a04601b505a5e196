"""Made-up traces."""

from dataclasses import replace
from typing import Any

import numpy as np

from flows.lab.experiments.trial import Trace
from operators.batch import Reals

_T = np.arange(700) / 100  # s


def make_trace(**columns: Any) -> Trace:
    """A trace of 7 s in which nothing happens except in the given columns."""
    zero, never = np.zeros(700), np.zeros(700, np.bool_)
    counts = np.zeros((700, 6), np.int16)
    calm = Trace(_T, counts, zero, zero + 1, zero, zero, zero, zero, zero, never, never)
    slides = {"fastest": columns["speed"]} if "speed" in columns else {}
    return replace(calm, **{**slides, **columns})


def during(*spans: tuple[float, float], value: float = 1.0) -> Reals:
    """A column that is `value` within spans (s), else 0."""
    inside = np.zeros(700, np.bool_)
    for start, end in spans:
        inside |= (start - 1e-9 <= _T) & (end - 1e-9 > _T)
    return np.where(inside, value, 0.0)
