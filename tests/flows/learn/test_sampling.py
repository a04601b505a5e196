"""Figures do not depend on the rate at which a recording was sampled."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flows.learn.alarm_calibration import PATH, try_settings
from flows.learn.event_metrics import TrueSlips, tuned
from flows.learn.labelled_recordings import LabelledRecording, Sampling
from flows.learn.measures import judged
from operators import Debounce
from operators.batch import Reals
from operators.fingertip import TAKKTILE

Scored = tuple[LabelledRecording, Reals]


def scored(seed: int, samples: int = 3000) -> Scored:
    """Return a recording at 100 Hz with slips, brief ones and unknown labels, and probabilities for it."""
    random = np.random.default_rng(seed)
    label = np.repeat(random.choice([0, 1, 1, 0, -1], samples // 20), random.integers(3, 60, samples // 20))
    label = label[:samples].astype(np.int8)
    label[:120] = 0  # nothing at the end of the warm-up, which is half a sample later at twice the rate
    counts = np.cumsum(random.normal(0, 1 + 9 * (label == 1), (6, len(label))), axis=1).T
    logit = 6.0 * np.roll(label == 1, 2) - 3 + random.normal(0, 1.5, len(label))
    logit[random.random(len(label)) < 0.01] = np.nan
    logit[:120] = -3.0
    recording = LabelledRecording(counts.astype(np.int16), label, name=str(seed), sliding=label)
    return recording, 1 / (1 + np.exp(-logit))


def repeated(one: Scored, times: int) -> Scored:
    """Return the recording with each sample `times`, at a rate as much higher."""
    recording, probability = one
    rows = np.repeat(np.arange(len(recording)), times)
    found = replace(
        recording,
        counts=recording.counts[rows],
        label=recording.label[rows],
        sliding=recording.label[rows],
        fingertip=replace(TAKKTILE, rate=100.0 * times),
    )
    return found, probability[rows]


def values(results: pl.DataFrame, metric: str) -> list[float]:
    return results.filter(metric=metric)["value"].to_list()


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    times=st.sampled_from([2, 5, 10]),
    rule=st.builds(Debounce, st.sampled_from([0.3, 0.5, 0.8]), st.integers(1, 5), st.integers(1, 12)),
)
def test_a_recording_at_another_rate_has_the_same_figures(seed: int, times: int, rule: Debounce) -> None:
    (slow, probability), (fast, repeats) = scored(seed), repeated(scored(seed), times)
    one = judged(slow, probability, rule, method="")
    other = judged(fast, repeats, fast.sampling.rule(rule), method="")
    for metric in ("events", "false alarms", "missed slips", "slips", "sliding: false alarms"):
        assert values(other, metric) == values(one, metric)
    for metric in ("delay ms", "lead ms", "sliding: delay ms"):
        assert values(other, metric) == pytest.approx(values(one, metric), abs=10)
    for metric in ("minutes", "static minutes"):
        assert values(other, metric) == pytest.approx(values(one, metric), abs=10 / 60_000)
    for part in ("", "far: ", "sliding: "):
        for metric in ("static as static", "static as slip", "slip as static", "slip as slip"):
            [few], [many] = values(one, part + metric), values(other, part + metric)
            assert many == pytest.approx(times * few, abs=2 * times)


@pytest.mark.parametrize("times", [2, 10])
def test_the_chosen_settings_take_as_long_at_another_rate(times: int) -> None:
    slow = [scored(seed) for seed in range(4)]
    fast = [repeated(each, times) for each in slow]
    chosen = [
        tuned([score for _, score in each], [TrueSlips.labelled(recording) for recording, _ in each])
        for each in (slow, fast)
    ]
    assert chosen[1] == Sampling(100.0 * times).rule(chosen[0])
    trials = [try_settings([one for one, _ in each], [score for _, score in each]) for each in (slow, fast)]
    assert trials[1].rules == tuple(map(Sampling(100.0 * times).rule, PATH))
    np.testing.assert_array_equal(trials[1].alarms, trials[0].alarms)
    np.testing.assert_allclose(trials[1].minutes, trials[0].minutes, atol=1e-3)
