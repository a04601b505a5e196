from dataclasses import replace

import numpy as np
import pytest

from flows.learn.evaluation.event_metrics import EventMetrics
from flows.learn.evaluation.intervals import Estimate, Judged, balanced_accuracy, figures
from flows.learn.evaluation.sample_metrics import Confusion
from flows.learn.labelled_recordings import LabelledRecording
from operators import Debounce
from operators.batch import Reals


def judged(seed: int, shift: float, delay: float = 40.0, false: int = 1) -> Judged:
    random = np.random.default_rng(seed)
    slip = random.random(500) < 0.3
    probability = 1 / (1 + np.exp(-random.normal(0, 1, 500) - shift * (slip - 0.5)))
    events = EventMetrics(np.full(4, delay), missed_slips=1, false_alarms=false, repeats=0, minutes=0.5)
    return Judged(probability, slip, events, onsets=5, minutes=1.0, far=np.arange(500) % 50 > 10)


def test_the_interval_contains_the_figure_and_widens_with_the_differences_between_recordings() -> None:
    alike = figures([[judged(n, 2.0)] for n in range(20)])
    differing = figures([[judged(n, 0.2 * n)] for n in range(20)])
    for found in (alike, differing):
        for estimate in (found.balanced, found.area):
            assert estimate.low < estimate.value < estimate.high
    for name in ("balanced", "area"):
        one, other = getattr(alike, name), getattr(differing, name)
        assert other.high - other.low > 2 * (one.high - one.low)


def test_equal_recordings_have_an_interval_of_no_width() -> None:
    found = figures([[judged(0, 2.0)] for _ in range(5)])
    for name in ("balanced", "events_per_min", "false_alarms_per_min", "missed", "delay"):
        estimate = getattr(found, name)
        assert (estimate.low, estimate.high) == pytest.approx((estimate.value, estimate.value))
    assert (found.area.low, found.area.high) == pytest.approx((found.area.value,) * 2, abs=0.3)
    assert (found.events_per_min.value, found.false_alarms_per_min.value) == (5.0, 2.0)
    assert (found.missed.value, found.delay.value) == (20.0, 40.0)


def test_the_interval_covers_the_truth_about_as_often_as_it_says() -> None:
    random, hits = np.random.default_rng(0), 0
    for seed in range(100):
        right = random.binomial(100, random.beta(16, 4, 30))  # recordings differ; on average 80 %
        confusions = [Confusion(np.array([[k, 100 - k], [100 - k, k]], np.float64)) for k in right]
        found = balanced_accuracy(confusions, draws=400, seed=seed)
        hits += found.low <= 80 <= found.high
    assert 85 <= hits <= 100


def test_fewer_than_three_recordings_give_no_interval() -> None:
    found = figures([[judged(0, 2.0)], [judged(1, 2.0)]])
    assert found.balanced.interval() == found.delay.interval() == ""
    assert found.balanced.value > 70


def test_figures_without_events_or_classes_are_unknown() -> None:
    nothing = EventMetrics(np.empty(0), missed_slips=0, false_alarms=0, repeats=0, minutes=0.0)
    still = Judged(np.full(9, 0.1), np.zeros(9, np.bool_), nothing, 0, 0.1, np.ones(9, np.bool_))
    found = figures([[still]] * 4)
    for name in ("balanced", "area", "missed", "delay", "false_alarms_per_min"):
        assert np.isnan(getattr(found, name).value)
        assert getattr(found, name).interval() == ""
    assert figures([]).balanced.interval() == ""


def test_the_calibration_error_is_that_of_all_samples_together() -> None:
    def constant(slips: int) -> Judged:
        one = judged(0, 2.0)
        return replace(one, probability=np.full(500, 0.3), slip=np.arange(500) < slips)

    found = figures([[constant(slips)] for slips in (50, 100, 150, 200, 250)]).calibration  # 10 to 50 % slip
    assert found.value == pytest.approx(0)
    assert 0 < found.high < 20  # draws of recordings have other shares of slip
    alike = figures([[constant(50)]] * 4).calibration
    assert (alike.value, alike.low, alike.high) == pytest.approx((20, 20, 20))


def test_repetitions_of_a_recording_count_as_one_recording() -> None:
    once = [[judged(n, 0.3 * n)] for n in range(10)]
    twice = [own * 2 for own in once]
    assert figures(once).balanced == figures(twice).balanced
    assert figures(once).delay == figures(twice).delay


def test_samples_without_a_label_or_an_answer_do_not_count() -> None:
    label = np.repeat([0, 1, -1], 200).astype(np.int8)
    recording = LabelledRecording(np.zeros((600, 6), np.int16), label, "plane")
    probability: Reals = np.where(np.arange(600) < 150, np.nan, 0.9)
    found = Judged.of(recording, probability, Debounce())
    assert (len(found.slip), found.slip.sum()) == (250, 200)
    assert found.minutes == pytest.approx(5.01 / 60)
    assert found.onsets == 1
    assert found.far.tolist() == [place // 10 not in (19, 20, 39) for place in range(150, 400)]


def test_far_from_changes_only_those_samples_count() -> None:
    near = np.arange(500) % 50 < 25
    wrong = judged(0, 2.0)
    found = figures(
        [[replace(wrong, probability=np.where(near, 0.5, wrong.slip * 1.0), far=~near)] for _ in range(3)]
    )
    assert found.far.value == 100
    assert found.balanced.value < 80


def test_the_interval_of_an_unknown_figure_is_empty() -> None:
    assert Estimate.of(np.nan, np.array([np.nan])).interval() == ""
