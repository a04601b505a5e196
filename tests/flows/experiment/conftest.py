"""Traces that are made up, to be judged."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flows.experiment.trial import Trace
from operators.batch import Reals

_T = np.arange(600) / 100  # s


@pytest.fixture
def made() -> Callable[..., Trace]:
    """A trace of 6 s in which nothing happens but what is said, column by column."""
    nothing, never = np.zeros(600), np.zeros(600, np.bool_)
    counts = np.zeros((600, 6), np.int16)
    calm = Trace(
        _T, counts, nothing, nothing + 1, nothing + 1, nothing, nothing, nothing, nothing, never, never
    )

    def trace(**changed: Any) -> Trace:  # noqa: ANN401 - columns of several types
        return replace(calm, **changed)

    return trace


@pytest.fixture
def during() -> Callable[..., Reals]:
    """A column that is `value` within spans (s), else 0."""

    def column(*spans: tuple[float, float], value: float = 1.0) -> Reals:
        inside = np.zeros(600, np.bool_)
        for since, until in spans:
            inside |= (since - 1e-9 <= _T) & (until - 1e-9 > _T)
        return np.where(inside, value, 0.0)

    return column
