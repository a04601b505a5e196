import numpy as np
import pytest

from connectors.events import encode
from connectors.web.curves import GAP, curve_json, plotted_values, thin_curve
from operators.batch import Motion, Scores, Touch, ms, s


def test_an_invalid_cell_is_null() -> None:
    counts, valid = np.arange(6, dtype=np.int16)[None], np.array([[True, True, True, False, True, True]])
    touch = Touch(np.array([s]), counts, counts, valid)
    assert (
        encode(curve_json(touch.time, plotted_values(touch), s))
        == b'{"t":[0.0],"v":[[0.0,1.0,2.0,null,4.0,5.0]]}'
    )


def test_speed_is_that_of_the_tcp_in_mm_per_second() -> None:
    velocity = np.array([[0.003, 0.0, -0.004, 9.0, 9.0, 9.0]])
    motion = Motion(np.array([s]), np.array([s]), velocity, np.full((1, 6), np.nan))
    assert plotted_values(motion) == pytest.approx([5.0])


def test_an_unknown_probability_is_null() -> None:
    scores = Scores(np.array([s, s + 10 * ms]), np.array([0.5, np.nan]))
    assert encode(curve_json(scores.time, plotted_values(scores), s)) == b'{"t":[0.0,10.0],"v":[0.5,null]}'


def test_thinning_loses_no_peak_of_any_column() -> None:
    time, values = np.arange(10_001), np.zeros((10_001, 2))
    values[3_333, 0], values[7_777, 1] = 9.0, -9.0
    thin, kept = thin_curve(time, values, 0, 10_000, 100)
    assert len(thin) == len(kept) == 200
    assert kept.max(axis=0).tolist() == [9.0, 0.0]
    assert kept.min(axis=0).tolist() == [0.0, -9.0]
    assert (np.diff(thin) >= 0).all()
    assert (thin[0], thin[-1]) == (0, 10_000)


def test_unevenly_spaced_rows_stay_in_their_pixel_columns() -> None:
    time = np.concatenate(
        (np.arange(0, 100), np.arange(900, 1000, 10))
    )  # of 10 columns the first and the last
    thin, kept = thin_curve(time, time.astype(np.float64), 0, 1000, 10)
    assert thin.tolist() == [0, 99, 900, 990]
    assert kept.tolist() == [0, 99, 900, 990]


@pytest.mark.parametrize("columns", [2, 1000])
def test_no_line_crosses_a_pause(columns: int) -> None:
    before = np.arange(10) * ms
    after = before[-1] + GAP + 1 + before
    time, values = thin_curve(np.concatenate((before, after)), np.ones((20, 6)), 0, 2 * GAP, columns)
    [gap] = np.flatnonzero(np.isnan(values).any(axis=1)).tolist()
    assert (time[gap - 1], time[gap], time[gap + 1]) == (before[-1], before[-1] + 1, after[0])
    assert np.isnan(values[gap]).all()


def test_few_rows_are_not_thinned() -> None:
    time, values = np.arange(4), np.array([1.0, 2.0, 3.0, 4.0])
    thin, kept = thin_curve(time, values, 0, 3, 2)
    assert (thin.tolist(), kept.tolist()) == ([0, 1, 2, 3], [1, 2, 3, 4])
    assert len(thin_curve(time[:0], values[:0], 0, 3, 2)[0]) == 0


def test_a_nan_hides_no_other_value_of_its_column() -> None:
    values = np.full(100, np.nan)
    values[51] = 7.0
    _, kept = thin_curve(np.arange(100), values, 0, 99, 5)
    assert np.nanmax(kept) == 7.0
    assert np.isnan(kept[:4]).all()
