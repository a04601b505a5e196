from typing import Literal

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators import Align, Motion, Sample, Touch, Zero, Zeroed, concat, ms, s
from operators.batch import Reals, Times

How = Literal["nearest", "previous"]
NO_TOUCH, NO_MOTION = Zeroed.empty(), Motion.empty()


def _touch(*time: float) -> Zeroed:
    counts = np.arange(6 * len(time), dtype=np.int16).reshape(-1, 6)
    return Zeroed(_stamps(*time), counts, counts + np.int16(1), counts > 0, finger=2)


def _motion(*time: float) -> Motion:
    """Motion whose velocity along x is the number of the row."""
    velocity = np.outer(np.arange(len(time)), [1, 0, 0, 0, 0, 0])
    return Motion.rows(_stamps(*time), _stamps(*time), velocity, np.nan)


def _stamps(*time: float) -> Times:
    return (np.array(time) * ms).astype(np.int64)


def _rows(samples: Sample) -> list[float]:
    rows: list[float] = samples.velocity[:, 0].tolist()
    return rows


def _join(align: Align, touch: Zeroed, motion: Motion) -> Sample:
    return concat(Sample, [align.push(touch, motion), align.flush()])


steps = st.lists(st.sampled_from([0, 1, 3, 7, 8, 10, 12, 40, -5, -20]), max_size=60)  # some rows come late


def _polars(touch: pl.DataFrame, motion: pl.DataFrame, how: How, within: int) -> pl.Series:
    """The row that each touch is joined with, null where none."""

    def asof(strategy: Literal["backward", "forward"], suffix: str) -> pl.DataFrame:
        joined = touch.join_asof(motion, on="time", strategy=strategy, tolerance=within)
        off = (pl.col("time") - pl.col("stamp")).abs()
        return joined.select(pl.col("row").alias(f"row_{suffix}"), off.alias(f"off_{suffix}"))

    before, after = asof("backward", "before"), asof("forward", "after")
    exact = pl.col("off_before") == 0
    far = pl.lit(within + 1)
    later = pl.col("off_after").fill_null(far) <= pl.col("off_before").fill_null(far)
    row = {
        "previous": pl.col("row_before"),
        "nearest": pl.when(~exact.fill_null(value=False) & later).then("row_after").otherwise("row_before"),
    }
    return before.hstack(after).select(row[how]).to_series()


def _kept(**column: Times | Reals) -> pl.DataFrame:
    """The rows that are not late."""
    return pl.DataFrame(column).filter(pl.col("time") >= pl.col("time").cum_max()).set_sorted("time")


@pytest.mark.parametrize("how", ["previous", "nearest"])
@given(touch=steps, motion=steps, offset=st.integers(-50, 50), within=st.sampled_from([0, 3, 10, 30]))
def test_it_joins_as_polars(how: How, touch: list[int], motion: list[int], offset: int, within: int) -> None:
    left, right = _touch(*np.cumsum(touch)), _motion(*offset + np.cumsum(motion))
    samples = _join(Align(within * ms, how), left, right)
    kept = _kept(time=left.time)
    numbers = np.arange(len(right), dtype=np.float64)
    rows = _polars(kept, _kept(time=right.time, stamp=right.time, row=numbers), how, within * ms)
    timely = left[left.time >= np.maximum.accumulate(left.time)]
    for name in ("time", "counts", "temperature", "valid"):
        np.testing.assert_array_equal(getattr(samples, name), getattr(timely, name))
    assert samples.finger == 2 or not len(samples)
    np.testing.assert_array_equal(samples.matched, rows.is_not_null().to_numpy())
    assert np.isnan(samples.velocity[~samples.matched]).all()
    np.testing.assert_allclose(_rows(samples), rows.fill_null(np.nan).to_numpy(), rtol=1e-12)


@pytest.mark.parametrize("unknown", [np.nan, np.inf])
def test_motion_with_a_non_finite_velocity_is_ignored(unknown: float) -> None:
    motion = _motion(0, 9, 18)
    motion.velocity[1, 5] = unknown
    align = Align()
    align.push(NO_TOUCH, motion)
    assert _rows(align.push(_touch(8.9, 9, 9.1), NO_MOTION)) == [0, 2, 2]


def test_a_touch_is_given_once_newer_motion_has_come() -> None:
    align = Align()
    assert len(align.push(_touch(10), _motion(0, 10))) == 0
    assert len(align.push(NO_TOUCH, _motion(10))) == 0
    assert _rows(align.push(NO_TOUCH, _motion(10.5, 10.5))) == [0]  # of those at 10, the last


def test_a_touch_sample_waits_until_the_touch_stream_is_wait_ahead() -> None:
    align = Align(wait=30 * ms)
    assert len(align.push(_touch(0, 10, 29), NO_MOTION)) == 0
    samples = align.push(_touch(41), NO_MOTION)
    assert samples.time.tolist() == [0, 10 * ms]
    assert not samples.matched.any()


def test_a_touch_that_lags_motion_by_more_than_keep_finds_no_match() -> None:
    align = Align(keep=50 * ms)
    align.push(NO_TOUCH, _motion(*range(0, 101, 10)))
    assert align.push(_touch(49, 50), NO_MOTION).matched.tolist() == [False, True]


@pytest.mark.parametrize("rate", [5, 8, 100])
def test_samples_that_waited_for_their_baseline_find_their_motion(rate: int) -> None:
    zero, align, found = Zero(), Align(), list[Sample]()
    for time in range(0, 30 * s, s // rate):
        touch = Touch.zeros().later(time)
        found.append(align.push(zero.push(touch), Motion.zeros().later(time)))
    found.append(align.flush())
    samples = concat(Sample, found)
    assert len(samples) == 30 * rate
    assert samples.matched.all()
