import math
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from flows.learn.alarm_calibration import (
    PATH,
    SettingTrials,
    TooLittleDataError,
    alarm_limit,
    calibrated,
    try_settings,
)
from flows.learn.event_metrics import EventMetrics
from flows.learn.labelled_recordings import LabelledRecording
from operators.batch import Reals

DRAWS = 600
MARGIN = 3 * math.sqrt(0.05 * 0.95 / DRAWS)  # three standard errors of the share of draws at 95 %
RATES = np.geomspace(0.02, 20, len(PATH))  # true false alarms per minute of each setting


def trials(alarms: NDArray[np.int64], minutes: Reals) -> SettingTrials:
    """Return trials with these false alarms (settings, sessions) and no slips."""
    none = np.empty(0)
    return SettingTrials(
        [[EventMetrics(none, 0, int(n), 0, m) for n, m in zip(row, minutes, strict=True)] for row in alarms]
    )


def nested(random: np.random.Generator, sessions: int, minutes: float) -> SettingTrials:
    """Draw alarms of settings that each raise all alarms of the stricter ones."""
    added = np.diff(RATES, prepend=0)[:, None] * minutes
    alarms = random.poisson(added, (len(PATH), sessions)).cumsum(axis=0)
    return trials(alarms, np.full(sessions, minutes))


def noisy(seed: int, seconds: int = 200) -> tuple[LabelledRecording, Reals]:
    """Return a recording with a slip every ten seconds, and probabilities that are sometimes wrong."""
    random = np.random.default_rng(seed)
    label = (np.arange(100 * seconds) % 1000 > 900).astype(np.int8)
    logit = 6.0 * label - 3 + np.repeat(random.normal(0, 1.4, 10 * seconds), 10)
    recording = LabelledRecording(np.zeros((len(label), 6), np.int16), label, name=str(seed))
    return recording, 1 / (1 + np.exp(-logit))


def test_the_settings_are_nested_from_strict_to_sensitive() -> None:
    for strict, sensitive in pairwise(PATH):
        assert strict.threshold >= sensitive.threshold
        assert strict.consecutive >= sensitive.consecutive
        assert strict.release >= sensitive.release
        assert strict != sensitive


@settings(max_examples=2, deadline=None)
@example(seed=95, rate=0.5, confidence=0.95)
@given(
    seed=st.integers(0, 1000),
    rate=st.sampled_from([0.5, 1.0, 3.0]),
    confidence=st.sampled_from([0.8, 0.9, 0.95]),
)
def test_the_rate_of_the_chosen_setting_holds_with_the_confidence(
    seed: int, rate: float, confidence: float
) -> None:
    random, draws, chosen = np.random.default_rng(seed), 200, list[int]()
    for _ in range(draws):
        with suppress(TooLittleDataError):  # chance alarms of the strictest setting: no setting, no promise
            chosen.append(PATH.index(calibrated(nested(random, 40, 0.5), rate, confidence).debounce))
    error = 1 - confidence
    assert len(chosen) > 0.95 * draws
    assert np.count_nonzero(RATES[chosen] > rate) <= draws * error + 3 * math.sqrt(draws * error * confidence)
    assert np.median(RATES[chosen]) > rate / 4


def test_too_little_static_time_is_an_error_with_the_time_that_is_needed() -> None:
    silent = trials(np.zeros((len(PATH), 4), np.int64), np.full(4, 0.5))
    assert calibrated(silent, 1.5, 0.95).bound == pytest.approx(-math.log(0.05) / 2)
    with pytest.raises(TooLittleDataError, match=r"in 2 static .* but 3 are needed; record 0\.996 more"):
        calibrated(silent, 1.0, 0.95)
    with pytest.raises(TooLittleDataError, match=r"in 0\.02 .* but 0\.03 are needed; record 0\.00996 more"):
        calibrated(trials(silent.alarms, np.full(4, 0.005)), 100.0, 0.95)


def test_without_slips_the_most_sensitive_accepted_setting_is_chosen() -> None:
    alarms = np.zeros((len(PATH), 10), np.int64)
    alarms[20:] = 5
    assert calibrated(trials(alarms, np.ones(10)), 1.0, 0.95).debounce == PATH[19]


def test_a_higher_rate_never_costs_more() -> None:
    recordings, probabilities = zip(*map(noisy, range(12)), strict=True)
    every = try_settings(recordings, probabilities)
    found = [calibrated(every, rate, 0.95).measured for rate in (0.5, 2.0, 8.0, 30.0)]
    costs = [each.delays.sum() + 1000 * each.missed_slips for each in found]
    assert costs == sorted(costs, reverse=True)
    assert costs[0] > costs[-1]
    alarms = [each.false_alarms for each in found]
    assert alarms == sorted(alarms)


def test_a_single_session_is_cut_into_pieces() -> None:
    recording, probability = noisy(0, seconds=600)
    found = try_settings([recording], [probability])
    assert len(found.minutes) == 10
    assert found.minutes.sum() == pytest.approx(9.0, abs=0.3)


def test_fingertips_of_one_session_are_one_unit() -> None:
    recordings, probabilities = zip(*map(noisy, range(4)), strict=True)
    alone = try_settings(recordings, probabilities)
    pairs = [replace(each, name=name) for each, name in zip(recordings, "aabb", strict=True)]
    paired = try_settings(pairs, probabilities)
    assert (len(alone.minutes), len(paired.minutes)) == (4, 2)
    assert paired.minutes.sum() == pytest.approx(alone.minutes.sum())
    np.testing.assert_array_equal(paired.alarms, alone.alarms[:, ::2] + alone.alarms[:, 1::2])


def test_clustered_alarms_have_a_higher_limit_which_nearly_holds() -> None:
    """Rates of 30 sessions with an exponential distribution; the Poisson limit fails four times as often."""
    random = np.random.default_rng(0)
    draws = [random.poisson(random.exponential(3, 30)) for _ in range(DRAWS)]
    poisson = [alarm_limit(np.array([alarms.sum()]), np.ones(1), 0.95) for alarms in draws]
    clustered = [alarm_limit(alarms, np.ones(30), 0.95) for alarms in draws]
    assert np.mean(np.array(poisson) < 90) > 0.15
    assert np.mean(np.array(clustered) < 90) <= 0.07 + MARGIN


@given(alarms=st.lists(st.integers(0, 30), min_size=2, max_size=30), scale=st.floats(0.1, 10))
def test_the_limit_is_at_least_that_of_unclustered_alarms_and_independent_of_the_unit_of_time(
    alarms: list[int], scale: float
) -> None:
    counts, minutes = np.array(alarms), np.linspace(1, 2, len(alarms))
    limit = alarm_limit(counts, minutes, 0.95)
    assert limit >= alarm_limit(np.array([counts.sum()]), np.ones(1), 0.95) - 1e-9
    assert limit == pytest.approx(alarm_limit(counts, scale * minutes, 0.95), rel=1e-9)
    assert limit < alarm_limit(counts, minutes, 0.99)
