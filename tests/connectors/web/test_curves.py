from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from connectors.events import encode
from connectors.web.curves import GAP, curve_json, plotted, thin_curve
from operators.batch import Scores, Touch, ms, s


def test_an_invalid_cell_and_an_unknown_probability_are_null() -> None:
    counts, valid = np.arange(6, dtype=np.int16)[None], np.array([[True, True, True, False, True, True]])
    touch = Touch(np.array([s]), counts, counts, valid)
    json = encode(curve_json(touch.time, plotted(touch)[1], s))
    assert json == b'{"t":[0.0],"v":[[0.0,1.0,2.0,null,4.0,5.0]]}'
    scores = Scores(np.array([s, s + 10 * ms]), np.array([0.5, np.nan]))
    assert encode(curve_json(scores.time, plotted(scores)[1], s)) == b'{"t":[0.0,10.0],"v":[0.5,null]}'


@given(
    st.lists(st.tuples(st.integers(1, 60), st.one_of(st.just(np.nan), st.integers(-9, 9))), max_size=80),
    st.integers(1, 9),
)
def test_thinning_keeps_the_extremes_of_each_column_and_no_line_crosses_a_pause(
    rows: list[tuple[int, float]], columns: int
) -> None:
    """Times step by 5 to 300 ms; a pause is longer than 250 ms."""
    time = np.cumsum(np.array([5 * ms * step for step, _ in rows], np.int64))
    values = np.array([value for _, value in rows], np.float64)
    end = int(time.max(initial=1))
    thin, kept = thin_curve(time, values, 0, end, columns)
    assert (np.diff(thin) >= 0).all()
    inserted = {int(before) + 1 for before, after in pairwise(time.tolist()) if after - before > GAP}
    edges = np.linspace(0, end, columns, endpoint=False)
    column, thin_column = (np.searchsorted(edges, at, "right") for at in (time, thin))
    if len(time) <= 2 * columns:
        assert set(thin.tolist()) == {*time.tolist(), *inserted}
    else:
        assert len(thin) <= 2 * columns + len(inserted)
    for k in range(1, columns + 1):
        every, left = values[column == k], kept[thin_column == k]
        if not np.isnan(every).all():
            assert (np.nanmin(left), np.nanmax(left)) == (np.nanmin(every), np.nanmax(every))
    for row, (before, after) in enumerate(pairwise(thin.tolist())):
        assert after - before <= GAP or np.isnan(kept[[row, row + 1]]).any() or len(time) > 2 * columns
