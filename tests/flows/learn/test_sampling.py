"""Figures do not depend on the rate at which a recording was sampled."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flows.learn.alarms.alarm_calibration import PATH, try_settings
from flows.learn.evaluation.debounce_tuning import joined, tuned
from flows.learn.evaluation.evaluation_study import PAPER_RULE
from flows.learn.evaluation.event_metrics import EventMetrics, Slips, lead_ms, onsets, performances
from flows.learn.evaluation.intervals import Judged
from flows.learn.evaluation.sample_metrics import Confusion, LabelChanges
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.sampling import Sampling
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
    recording = LabelledRecording(counts.astype(np.int16), label, "plane", name=str(seed), sliding=label)
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


def counted(events: EventMetrics) -> tuple[int, ...]:
    return events.missed_slips, events.false_alarms, events.repeats, len(events.delays)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    times=st.sampled_from([2, 5, 10]),
    rule=st.builds(Debounce, st.sampled_from([0.3, 0.5, 0.8]), st.integers(1, 5), st.integers(1, 12)),
)
def test_a_recording_at_another_rate_has_the_same_figures(seed: int, times: int, rule: Debounce) -> None:
    (slow, probability), (fast, repeats) = scored(seed), repeated(scored(seed), times)
    period = 10.0  # ms, of the slow one
    one = Judged.of(slow, probability, rule)
    other = Judged.of(fast, repeats, fast.sampling.rule(rule))
    assert counted(other.events) == counted(one.events)
    np.testing.assert_allclose(other.events.delays, one.events.delays, atol=period)
    assert other.onsets == one.onsets
    assert other.minutes == pytest.approx(one.minutes, abs=period / 60_000)
    assert other.events.minutes == pytest.approx(one.events.minutes, abs=period / 60_000)
    assert Confusion.of(other.probability >= 0.5, other.slip).balanced == pytest.approx(
        Confusion.of(one.probability >= 0.5, one.slip).balanced, abs=0.2
    )
    assert other.far.sum() == pytest.approx(times * one.far.sum(), abs=2 * times)


@pytest.mark.parametrize("times", [2, 10])
def test_the_chosen_settings_take_as_long_at_another_rate(times: int) -> None:
    slow = [scored(seed) for seed in range(4)]
    fast = [repeated(each, times) for each in slow]
    chosen = [
        tuned([score for _, score in each], [Slips.labelled(recording) for recording, _ in each])
        for each in (slow, fast)
    ]
    assert chosen[1] == Sampling(100.0 * times).rule(chosen[0])
    trials = [try_settings([one for one, _ in each], [score for _, score in each]) for each in (slow, fast)]
    assert trials[1].rules == tuple(map(Sampling(100.0 * times).rule, PATH))
    np.testing.assert_array_equal(trials[1].alarms, trials[0].alarms)
    np.testing.assert_allclose(trials[1].minutes, trials[0].minutes, atol=1e-3)


def test_recordings_are_joined_sample_by_sample_where_their_rates_differ_a_little() -> None:
    recordings = [scored(seed) for seed in range(3)]
    fast = [(replace(each, fingertip=replace(TAKKTILE, rate=105.0)), score) for each, score in recordings]
    mixed = [recordings[0], *fast[1:]]
    _, alike = joined([score for _, score in recordings], [Slips.labelled(each) for each, _ in recordings])
    _, found = joined([score for _, score in mixed], [Slips.labelled(each) for each, _ in mixed])
    np.testing.assert_array_equal(found.found, alike.found)
    np.testing.assert_array_equal(found.tolerated, alike.tolerated)


def test_times_of_other_rates_are_in_ms() -> None:
    fast, probability = repeated(scored(3), 2)
    slow, score = scored(3)
    rule = fast.sampling.rule(PAPER_RULE)
    leads = [
        lead_ms([onsets(values, each_rule, each.sampling)], [Slips.labelled(each)])
        for each, values, each_rule in ((slow, score, PAPER_RULE), (fast, probability, rule))
    ]
    assert leads[1] == pytest.approx(leads[0], abs=10)
    delays = [
        performances([each], [values], each_rule)["sliding"].onset_ms
        for each, values, each_rule in ((slow, score, PAPER_RULE), (fast, probability, rule))
    ]
    assert delays[1] == pytest.approx(delays[0], abs=10)
    every = [np.arange(len(each)) for each in (slow, fast)]
    bins = [
        LabelChanges.of([each.label], [at], [at < 0], each.sampling)
        for each, at in zip((slow, fast), every, strict=True)
    ]
    np.testing.assert_array_equal(bins[1].samples, 2 * bins[0].samples)
    assert bins[0].spans[:2] == ["0-10", "20-30"]
    assert bins[1].spans[:2] == ["0-15", "20-35"]


def test_the_warm_up_is_a_second_or_a_hundred_samples() -> None:
    assert [Sampling(rate).warm_up for rate in (16.0, 100.0, 250.0, 1000.0)] == [99, 99, 249, 999]
    assert Sampling.measured(99.99) == Sampling.measured(100.01) == Sampling()
    assert Sampling.measured(97.3).period == 10_277_492
