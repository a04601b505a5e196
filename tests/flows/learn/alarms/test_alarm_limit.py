import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from flows.learn.alarms.alarm_limit import alarm_limit

Ints = NDArray[np.int64]
DRAWS = 600
MARGIN = 3 * math.sqrt(0.05 * 0.95 / DRAWS)  # three standard errors of the share of draws at 95 %


def exceeded(
    draw: Callable[[np.random.Generator], Ints],
    expected: float,
    limit: Callable[[Ints], float],
    seed: int,
) -> float:
    """Return the share of draws of alarms whose limit is below the expected number."""
    random = np.random.default_rng(seed)
    return float(np.mean([limit(draw(random)) < expected for _ in range(DRAWS)]))


def at_95(alarms: Ints) -> float:
    return alarm_limit(alarms, np.ones(len(alarms)), 0.95)


@given(confidence=st.floats(0.6, 0.999), minutes=st.lists(st.floats(0.01, 50), min_size=1, max_size=20))
def test_without_alarms_the_limit_is_the_logarithm_of_the_error_probability(
    confidence: float, minutes: list[float]
) -> None:
    limit = alarm_limit(np.zeros(len(minutes), np.int64), np.array(minutes), confidence)
    assert limit == pytest.approx(-math.log(1 - confidence), rel=1e-9)


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 1000), sessions=st.integers(10, 150))
def test_the_limit_holds_for_sessions_of_any_alarm_probabilities(seed: int, sessions: int) -> None:
    chances = np.random.default_rng(seed).beta(0.3, 1.2, sessions)

    def draw(random: np.random.Generator) -> Ints:
        return random.binomial(1, chances).astype(np.int64)

    assert exceeded(draw, float(chances.sum()), at_95, seed) <= 0.05 + MARGIN


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 1000), sessions=st.integers(2, 100), mean=st.floats(0.05, 3))
def test_the_limit_holds_for_poisson_alarms(seed: int, sessions: int, mean: float) -> None:
    def draw(random: np.random.Generator) -> Ints:
        return random.poisson(mean, sessions).astype(np.int64)

    assert exceeded(draw, mean * sessions, at_95, seed) <= 0.05 + MARGIN


def test_clustered_alarms_have_a_higher_limit_which_nearly_holds() -> None:
    """Rates of 30 sessions with an exponential distribution; the Poisson limit fails four times as often."""

    def draw(random: np.random.Generator) -> Ints:
        return random.poisson(random.exponential(3, 30)).astype(np.int64)

    def poisson(alarms: Ints) -> float:
        return alarm_limit(np.array([alarms.sum()]), np.ones(1), 0.95)

    assert exceeded(draw, 90, poisson, 0) > 0.15
    assert exceeded(draw, 90, at_95, 0) <= 0.07 + MARGIN


@given(alarms=st.lists(st.integers(0, 30), min_size=2, max_size=30), scale=st.floats(0.1, 10))
def test_the_limit_is_at_least_that_of_unclustered_alarms_and_independent_of_the_unit_of_time(
    alarms: list[int], scale: float
) -> None:
    counts, minutes = np.array(alarms), np.linspace(1, 2, len(alarms))
    limit = alarm_limit(counts, minutes, 0.95)
    assert limit >= alarm_limit(np.array([counts.sum()]), np.ones(1), 0.95) - 1e-9
    assert limit == pytest.approx(alarm_limit(counts, scale * minutes, 0.95), rel=1e-9)
    assert limit < alarm_limit(counts, minutes, 0.99)
