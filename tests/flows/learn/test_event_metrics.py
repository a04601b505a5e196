import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flows.learn.event_metrics import BRIEF, PAUSE, EventMetrics, TrueSlips, match_onsets, onsets, tuned
from flows.learn.labelled_recordings import WARM_UP, LabelledRecording
from operators import Debounce, ms, s
from operators.batch import Codes, Reals, Times
from tests.flows.learn.conftest import TWICE, label

PERIOD = 10 * ms


def sure(samples: int, *runs: tuple[int, int]) -> Reals:
    return np.where(label(samples, *runs), 0.9, 0.1)


def slips(codes: Codes, time: Times | None = None) -> TrueSlips:
    return TrueSlips.labelled(LabelledRecording(np.zeros((len(codes), 6), np.int16), codes, time=time))


def seconds(*stretches: tuple[int, int]) -> list[list[int]]:
    """First and last sample as times."""
    return [[first * PERIOD, last * PERIOD] for first, last in stretches]


def test_a_slip_goes_on_over_a_short_pause() -> None:
    pause = PAUSE // PERIOD
    assert slips(label(400, (150, 200), (199 + pause, 250))).found.tolist() == seconds((150, 249))
    assert len(slips(label(400, (150, 200), (200 + pause, 250))).found) == 2


def test_a_brief_slip_and_one_from_before_the_judged_part_are_excused() -> None:
    brief = BRIEF // PERIOD
    found = slips(label(400, (80, 130), (200, 199 + brief), (300, 300 + brief)))
    assert found.found.tolist() == seconds((300, 299 + brief))
    assert found.tolerated.tolist() == seconds((80, 129), (200, 198 + brief), (300, 299 + brief))


def test_where_nobody_knows_nothing_is_false_or_static() -> None:
    codes = label(400, (150, 200))
    codes[300:] = -1
    found = slips(codes)
    assert found.tolerated.tolist() == seconds((150, 199), (300, 399))
    assert found.static == (300 - WARM_UP - 50) * PERIOD
    metrics = EventMetrics.of([sure(400, (150, 200), (330, 340))], [found], TWICE)
    assert metrics.false_alarms == 0


def test_lost_samples_count_as_time() -> None:
    kept = np.flatnonzero(np.arange(400) % 3 != 1)
    codes, probability = label(400, (150, 250))[kept], sure(400, (150, 250))[kept]
    true = slips(codes, 7 + kept * PERIOD)
    begin = kept[WARM_UP]
    assert true.found.tolist() == seconds((150, 249))
    assert true.judged == (400 - begin) * PERIOD
    assert true.static == (400 - begin - 100 - 1) * PERIOD  # one sample was lost where the label changes
    assert EventMetrics.of([probability], [true], TWICE).delays.tolist() == [20]


def test_a_slip_that_goes_on_after_a_pause_of_the_recording_needs_no_second_onset() -> None:
    time = np.arange(400) * PERIOD
    time[200:] += 600 * s
    found = slips(label(400, (150, 250)), time)
    assert found.found.tolist() == seconds((150, 199))
    assert found.static == (400 - WARM_UP - 100) * PERIOD


def test_onsets_come_from_the_operator_after_the_judged_part_begins() -> None:
    probability = sure(400, (50, 120), (200, 201), (300, 310))
    assert (onsets(probability, TWICE, slips(label(400))) // PERIOD).tolist() == [WARM_UP + 1, 301]


def test_what_is_felt_is_counted_and_timed() -> None:
    true = slips(label(1200, (200, 250), (400, 450), (600, 650)))
    probability = sure(1200, (205, 220), (230, 240), (405, 406), (598, 640), (1000, 1010))
    metrics = EventMetrics.of([probability], [true], TWICE)
    assert metrics.delays.tolist() == [60, -10]
    assert (metrics.missed_slips, metrics.false_alarms, metrics.repeats, metrics.slips) == (1, 1, 1, 3)
    assert metrics.missed == pytest.approx(100 / 3)
    assert metrics.repeated == pytest.approx(100 / 3)
    assert metrics.minutes == pytest.approx((1200 - WARM_UP - 150) / 6000)


def test_a_detector_that_always_says_slip_misses_all_but_what_it_began_in() -> None:
    true = slips(label(1200, (200, 250), (400, 450)))
    metrics = EventMetrics.of([np.full(1200, 0.9)], [true], TWICE)
    assert (metrics.missed, metrics.false_alarms) == (100, 1)


def test_an_onset_may_be_a_little_early_or_ring_on() -> None:
    true = [(1000 * ms, 1100 * ms)]
    for onset, caught in ((949, False), (950, True), (1250, True), (1251, False)):
        assert (match_onsets(np.array([onset * ms]), true).missed == 0) == caught


@given(
    st.lists(st.integers(0, 5000), max_size=20).map(sorted),
    st.lists(st.integers(0, 5000), max_size=10, unique=True).map(sorted),
)
def test_every_slip_is_caught_or_missed(raised: list[int], starts: list[int]) -> None:
    true = [(start * ms, start * ms + ms) for start in starts]
    found = match_onsets(np.array(raised, np.int64) * ms, true)
    assert len(found.delays) + found.missed == len(true)
    assert 0 <= found.false <= len(raised)


def noisy(seed: int, number: int = 4, noise: float = 1.0) -> tuple[list[Reals], list[TrueSlips]]:
    """Slips, and probabilities that follow them 20 ms late, with errors that last some samples."""
    random = np.random.default_rng(seed)
    found, slips = list[Reals](), list[TrueSlips]()
    for _ in range(number):
        label = np.repeat(random.integers(0, 2, 40), random.integers(20, 60, 40)).astype(np.int8)
        wander = np.repeat(random.normal(size=len(label) // 3 + 1), 3)[: len(label)]
        logit = np.roll(label, 2) * 6 - 3 + noise * 2 * wander
        probability = 1 / (1 + np.exp(-logit))
        probability[random.random(len(label)) < 0.01] = np.nan
        found.append(probability)
        slips.append(TrueSlips.labelled(LabelledRecording(np.zeros((len(label), 6), np.int16), label)))
    return found, slips


def test_a_larger_budget_is_kept_with_a_margin_for_chance_and_spent_on_less_delay() -> None:
    found, slips = noisy(2, number=6)
    delays = list[float]()
    for budget in (4.0, 20.0, 80.0):
        events = EventMetrics.of(found, slips, tuned(found, slips, budget))
        assert events.false_alarms + 1 + np.sqrt(events.false_alarms + 0.75) <= budget * events.minutes
        delays.append(events.delays.mean())
    assert delays[0] > delays[1] > delays[2]


def test_missed_and_repeated_slips_are_kept_within_their_limits_where_that_can_be() -> None:
    found, slips = noisy(3, noise=0.3)
    events = EventMetrics.of(found, slips, tuned(found, slips))
    assert events.false_alarms < 2 * events.minutes
    assert events.missed <= 2
    assert events.repeated <= 2


def test_where_no_setting_keeps_the_budget_the_fewest_false_alarms_win() -> None:
    found, slips = noisy(4, noise=2.0)
    chosen = tuned(found, slips, budget=0.0)
    fewest = EventMetrics.of(found, slips, chosen).false_alarms
    for other in (Debounce(), Debounce(0.9, 3, 3), Debounce(0.95, 5, 12)):
        assert fewest <= EventMetrics.of(found, slips, other).false_alarms
