import numpy as np

from connectors.web.track import SPAN, STEP, Track
from operators.batch import Scores, ms, s


def scores(*times: int) -> Scores:
    return Scores(np.array(times, np.int64), np.zeros(len(times)))


def test_a_track_gives_what_is_new_once_and_keeps_it() -> None:
    track = Track(Scores)
    assert track.take() is None
    track.add(scores(0, 10 * ms))
    track.add(scores(20 * ms))
    new = track.take()
    assert new is not None
    assert new.time.tolist() == [0, 10 * ms, 20 * ms]
    assert track.take() is None
    assert track.rows.time.tolist() == [0, 10 * ms, 20 * ms]


def test_of_each_5_ms_the_first_row_is_kept_however_rows_are_cut() -> None:
    time = range(0, s, 2 * ms)
    whole, cut = Track(Scores), Track(Scores)
    whole.add(scores(*time))
    for each in time:
        cut.add(scores(each))
    assert whole.rows.time.tolist() == cut.rows.time.tolist()
    assert len(whole.rows) == s // STEP


def test_rows_older_than_one_that_came_are_left_out() -> None:
    track = Track(Scores)
    track.add(scores(100 * ms, 50 * ms, 110 * ms))
    track.add(scores(70 * ms))
    assert track.rows.time.tolist() == [100 * ms, 110 * ms]


def test_a_track_is_bounded_even_if_nobody_takes_it() -> None:
    track = Track(Scores)
    for second in range(120):
        track.add(scores(*range(second * s, (second + 1) * s, ms)))
    assert len(track.rows) <= SPAN // STEP + 1
    new = track.take()
    assert new is not None
    assert len(new) == len(track.rows)
    assert track.rows.time[-1] - track.rows.time[0] <= SPAN


def test_rows_that_were_given_stay_as_they_were() -> None:
    track = Track(Scores)
    track.add(scores(*range(0, s, 10 * ms)))
    new = track.take()
    assert new is not None
    before = new.time.tolist()
    for second in range(1, 90):
        track.add(scores(*range(second * s, (second + 1) * s, 10 * ms)))
    assert new.time.tolist() == before
