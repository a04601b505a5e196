import numpy as np
import pytest

from operators import Labelled, Operator, Pool, Resample, Sample, Touch, Zeroed, ms, s
from operators.fingertip import TAKKTILE
from tests.storage.made import new_batch


def wave(rate: float, frequency: float, seconds: float = 4.0) -> Touch:
    time = np.rint(np.arange(int(seconds * rate)) * (s / rate)).astype(np.int64)
    counts = np.rint(1000 * np.sin(2 * np.pi * frequency * time / s)).astype(np.int16)
    return Touch.rows(time, counts[:, None], 0, True)


@pytest.mark.parametrize("rate", [1000.0, 333.3, 200.0, 60.0, 16.0])
def test_a_slow_wave_is_the_same_at_any_rate_but_for_half_a_period_of_delay(rate: float) -> None:
    found = Resample(rate=100).push(wave(rate, 0.5))
    assert np.all(np.diff(found.time) == 10 * ms)
    assert found.valid.all()
    expected = 1000 * np.sin(2 * np.pi * 0.5 * (found.time - 5 * ms) / s)
    assert np.abs(found.counts[:, 0] - expected).max() < (10 if rate > 20 else 15)


def test_frequencies_above_the_new_rate_do_not_fold_back() -> None:
    found = Resample(rate=100).push(wave(1000.0, 190.0))
    assert np.abs(found.counts).max() < 120  # every tenth sample would have an amplitude of 1000


def test_output_times_do_not_depend_on_the_start() -> None:
    whole = wave(1000.0, 3.0)
    late = Resample(rate=100).push(whole[137:])
    same = Resample(rate=100).push(whole)
    shared = np.isin(same.time, late.time)
    assert late.counts[1:].tolist() == same.counts[shared][1:].tolist()


def test_nothing_is_made_up_in_a_gap() -> None:
    time = np.concatenate([np.arange(0, 100), np.arange(500, 600)]) * ms
    found = Resample(rate=100, gap=50 * ms).push(Touch.rows(time, np.zeros((200, 2)), 0, True))
    between = (found.time > 99 * ms) & (found.time < 505 * ms)
    assert not between.any()
    assert len(found) > 15


def test_a_cell_is_valid_if_lines_cover_half_of_the_period() -> None:
    valid = np.ones((101, 2), np.bool_)
    valid[23:26, 1] = valid[41:48, 1] = False
    found = Resample(rate=100).push(Touch.rows(np.arange(101) * ms, 7, 0, valid))
    assert found.valid[:, 0].all()
    assert np.flatnonzero(~found.valid[:, 1]).tolist() == [4]
    assert found.counts.tolist() == [[7, 7]] * 10


@pytest.mark.parametrize("operator", [Pool(((0, 1), (2,))), Resample(rate=50)])
@pytest.mark.parametrize("kind", [Touch, Zeroed, Sample, Labelled])
def test_touch_stays_raw_or_zeroed_and_no_label_or_motion_is_made_up(
    operator: Operator[Touch, Touch], kind: type[Touch]
) -> None:
    made = operator.reset_copy().push(new_batch(kind, 20, finger=1))
    assert type(made) is (Touch if kind is Touch else Zeroed)
    assert (len(made) > 5, made.finger) == (True, 1)


def test_the_fingertip_has_the_new_rate() -> None:
    assert Resample(rate=50).output_fingertip(TAKKTILE).rate == 50
