import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators import Touch, Window, ms


def _touch(rows: int) -> Touch:
    counts = np.arange(rows * 6, dtype=np.int16).reshape(rows, 6)
    return Touch(np.arange(rows) * 10 * ms, counts, counts, counts % 7 > 0, finger=5)


@given(rows=st.integers(1, 60), length=st.integers(1, 12), hop=st.integers(1, 15))
def test_windows_hold_the_newest_samples_at_every_hop_from_the_first_full_one_on(
    rows: int, length: int, hop: int
) -> None:
    touch, windows = _touch(rows), Window(length, hop).push(_touch(rows))
    ends = range(length, rows + 1, hop)
    assert windows.time.tolist() == [touch.time[end - 1] for end in ends]
    for window, valid, end in zip(windows.counts, windows.valid, ends, strict=True):
        np.testing.assert_array_equal(window, touch.counts[end - length : end])
        np.testing.assert_array_equal(valid, touch.valid[end - length : end])
    assert windows.finger == (5 if ends else -1)


def test_windows_are_read_only_views_of_the_same_memory() -> None:
    windows = Window(10).push(_touch(30))
    assert windows.counts.strides[0] == windows.counts.strides[1]
    assert np.shares_memory(windows.counts[0], windows.counts[1])
    for column in (windows.counts, windows.valid):
        with pytest.raises(ValueError, match="read-only"):
            column[0, 0, 0] = 1
