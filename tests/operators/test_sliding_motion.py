import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators import Align, Label, SlidingMotion, Truth, Zeroed, ms
from operators.batch import Codes, Reals, Times

PERIOD = 10 * ms


def truth(sliding: Reals, start: int = 0) -> Truth:
    rows = len(sliding)
    return Truth(start + np.arange(rows) * PERIOD, sliding, np.ones(rows), np.zeros((rows, 3)))


def touch(time: Times) -> Zeroed:
    cells = np.zeros((len(time), 6), np.int16)
    return Zeroed(time, cells, cells, cells == 0)


def labels(rows: Truth, samples: Zeroed) -> Codes:
    """Label samples by true sliding, as a flow does."""
    align, label = Align(within=20 * ms), Label()
    motion = SlidingMotion().push(rows)
    return np.concatenate([label.push(align.push(samples, motion)).label, label.push(align.flush()).label])


def test_a_sample_is_slip_once_the_contact_has_slid_half_a_millimetre_in_150_ms() -> None:
    rows = truth(np.repeat([0.0, 0.05, 0.0], 40))
    found = labels(rows, touch(rows.time)).tolist()
    assert found[:40] == [0] * 40
    assert found[41:80] == [1] * 39
    assert found[110:] == [0] * 10


@pytest.mark.parametrize(("static", "slip"), [(13, True), (30, False)])
def test_a_short_stick_between_two_slides_is_part_of_the_slip(static: int, slip: bool) -> None:
    sliding = np.zeros(100)
    sliding[20:30] = sliding[30 + static : 50 + static] = 0.05
    found = SlidingMotion().push(truth(sliding)).velocity[21 : 30 + static, 0]
    assert bool((found > 0.003).all()) == slip


def test_between_slip_and_rest_the_speed_is_unknown() -> None:
    sliding = np.zeros(100)
    sliding[50:53] = 0.01  # 0.3 mm: less than a slip, more than rest
    found = SlidingMotion().push(truth(sliding)).velocity[:, 0]
    assert np.isnan(found[52:75]).all()
    assert not np.isnan(found[:51]).any()
    assert found[80:].tolist() == [0] * 20


def test_nothing_slides_while_no_rows_come() -> None:
    before, after = truth(np.full(10, 0.05)), truth(np.full(2, 0.05), start=100 * PERIOD)
    operator = SlidingMotion()
    operator.push(before)
    assert operator.push(after).velocity[:, 0].tolist() == [0.0, pytest.approx(0.05 / 15)]


@given(st.lists(st.sampled_from([0.0, 0.002, 0.004, 0.1]), min_size=1, max_size=60), st.integers(1, 25))
def test_the_speed_is_the_mean_of_the_latest_rows(speeds: list[float], rows: int) -> None:
    span = rows * PERIOD
    found = SlidingMotion(span=span, rest=span).push(truth(np.array(speeds))).velocity[:, 0]
    travel = np.concatenate([[0.0], np.cumsum(speeds[1:]) * 0.01])  # m; the first row has no time before it
    mean = (travel - travel[np.maximum(np.arange(len(speeds)) - rows, 0)]) / (span / 1e9)
    unknown = np.isnan(found)
    assert np.allclose(found[~unknown], mean[~unknown])
    assert ((mean[unknown] <= 0.003 + 1e-9) & (mean[unknown] > 0.001 - 1e-9)).all()
