import json
from typing import Any

import numpy as np
import pytest

from connectors.events import encode
from connectors.web.page_frames import EVENTS_KEPT, FINGERS_MAX, KEPT, STEP, Frames, Track, rows_json
from operators.batch import EVERY, Faults, Motion, Scores, Slips, Touch, Zeroed, ms, s
from operators.health import FaultKind
from operators.ports import Json, Run

START = 90 * s  # of the run
NOW = 100 * s


@pytest.fixture
def frames(run: Run) -> Frames:
    return Frames(run)


def touch(kind: type[Touch], time: int, count: int, finger: int = 0) -> Touch:
    counts = np.full((1, 6), count, np.int16)
    return kind(np.array([time]), counts, counts, np.ones((1, 6), np.bool_), finger=finger)


def slips(time: int, state: int, finger: int = 0) -> Slips:
    return Slips(
        np.array([time]), np.array([state], np.int8), np.array([time]), np.array([0.9]), finger=finger
    )


def document(frame: dict[str, Json]) -> dict[str, Any]:
    read: dict[str, Any] = json.loads(encode(frame))
    return read


def test_a_frame_has_the_new_rows_of_each_stream(frames: Frames) -> None:
    frames.add(touch(Zeroed, START + 10 * ms, -7, finger=2))
    frames.add(Scores(np.array([START + 10 * ms]), np.array([0.25]), finger=2))
    velocity = np.array([[0.1, 0, 0, 0, 0, 0]])
    frames.add(Motion(np.array([START]), np.array([START]), velocity, np.full((1, 6), np.nan)))
    assert document(frames.next()) == {
        "touch": {"2": {"t": [10.0], "v": [[-7.0] * 6], "zeroed": True}},
        "scores": {"2": {"t": [10.0], "v": [0.25]}},
        "speed": {"t": [0.0], "v": [100.0]},
        "now": 10_000.0,
        "slipping": [],
        "faults": {},
        "quality": {"2": ["good", None]},
    }
    state: dict[str, Any] = {"slipping": [], "faults": {}, "quality": {"2": ["good", None]}}
    assert document(frames.next()) == {"now": 10_000.0, **state}
    assert document(rows_json(frames.rows(), START))["touch"]["2"]["t"] == [10.0]


def test_zeroed_counts_replace_raw_ones(frames: Frames) -> None:
    frames.add(touch(Touch, START, 700))
    assert document(frames.next())["touch"]["0"] == {"t": [0.0], "v": [[700.0] * 6], "zeroed": False}
    frames.add(touch(Zeroed, START, -3))
    frames.add(touch(Touch, START + 10 * ms, 700))
    assert document(frames.next())["touch"]["0"] == {"t": [0.0], "v": [[-3.0] * 6], "zeroed": True}


def test_an_event_has_its_latency_and_a_fingertip_slips_from_onset_to_end(frames: Frames) -> None:
    frames.add(slips(NOW - 8 * ms, 1, finger=1))
    frame = document(frames.next())
    assert frame["slipping"] == ["1"]
    assert frame["events"] == [
        {
            "id": 1,
            "t": 9_992.0,
            "finger": "1",
            "onset": True,
            "p": 0.9,
            "quality": ["good", None],
            "latency": 8.0,
            "verdict": ["good", "good"],
        }
    ]
    assert document(frames.next())["slipping"] == ["1"]
    frames.add(slips(NOW, 0, finger=1))
    frame = document(frames.next())
    assert frame["slipping"] == []
    assert [event["id"] for event in frame["events"]] == [2]


def test_the_quality_is_that_of_the_newest_score(frames: Frames) -> None:
    def quality(probability: float) -> object:
        time = np.array([START, START + 10 * ms])
        frames.add(Scores(time, np.array([0.5, probability]), finger=1))
        return document(frames.next())["quality"]

    assert quality(0.9) == {"1": ["good", None]}
    kinds = np.array([3], np.int8), np.array([FaultKind.STUCK], np.int8), np.array([True])
    frames.add(Faults(np.array([START]), *kinds, finger=1))
    assert quality(0.9) == {"1": ["doubtful", "barometer 3 stuck"]}
    assert quality(np.nan) == {"1": ["blind", "no probability"]}


def test_a_replay_at_full_speed_has_no_latency(frames: Frames, run: Run) -> None:
    run.live = False
    frames.add(slips(NOW, 1, finger=EVERY))
    [event] = document(frames.next())["events"]
    assert (event["latency"], event["finger"]) == (None, "every")


def test_the_newest_events_are_kept(frames: Frames) -> None:
    for k in range(EVENTS_KEPT + 50):
        frames.add(slips(START + k * ms, 1 - k % 2))
    assert len(document(frames.next())["events"]) == EVENTS_KEPT
    events: Any = frames.events(2)
    assert [event["id"] for event in events] == [EVENTS_KEPT + 49, EVENTS_KEPT + 50]


def test_faults_are_listed_while_they_last(frames: Frames) -> None:
    def fault(kind: FaultKind, *, active: bool) -> Faults:
        cell, kinds = np.array([3], np.int8), np.array([kind], np.int8)
        return Faults(np.array([START]), cell, kinds, np.array([active]), finger=0)

    frames.add(fault(FaultKind.STUCK, active=True))
    frames.add(fault(FaultKind.DRIFTING, active=False))
    assert document(frames.next())["faults"] == {"0": {"3": "stuck"}}
    frames.add(fault(FaultKind.STUCK, active=False))
    assert document(frames.next())["faults"] == {}


def test_fingertips_beyond_the_limit_are_ignored(frames: Frames) -> None:
    for finger in range(FINGERS_MAX + 9):
        frames.add(touch(Zeroed, START, -1, finger))
        frames.add(touch(Touch, START, 1, 100 + finger))
        frames.add(Scores(np.array([START]), np.array([0.5]), finger=finger))
    frame = document(frames.next())
    assert len(frame["scores"]) == FINGERS_MAX
    assert len(frame["touch"]) == FINGERS_MAX


def scores(*times: int) -> Scores:
    return Scores(np.array(times, np.int64), np.zeros(len(times)))


def test_a_track_returns_new_rows_once_and_keeps_them() -> None:
    track = Track(Scores)
    assert track.take() is None
    track.add(scores(0, 10 * ms))
    track.add(scores(20 * ms))
    new = track.take()
    assert new is not None
    assert new.time.tolist() == [0, 10 * ms, 20 * ms]
    assert track.take() is None
    assert track.rows.time.tolist() == [0, 10 * ms, 20 * ms]


def test_the_first_row_of_each_5_ms_is_kept_for_any_batch_cuts() -> None:
    time = range(0, s, 2 * ms)
    whole, cut = Track(Scores), Track(Scores)
    whole.add(scores(*time))
    for each in time:
        cut.add(scores(each))
    assert whole.rows.time.tolist() == cut.rows.time.tolist()
    assert len(whole.rows) == s // STEP


def test_rows_older_than_their_predecessors_are_dropped() -> None:
    track = Track(Scores)
    track.add(scores(100 * ms, 50 * ms, 110 * ms))
    track.add(scores(70 * ms))
    assert track.rows.time.tolist() == [100 * ms, 110 * ms]


def test_a_track_is_bounded_without_reads() -> None:
    track = Track(Scores)
    for second in range(120):
        track.add(scores(*range(second * s, (second + 1) * s, ms)))
    assert len(track.rows) <= KEPT // STEP + 1
    new = track.take()
    assert new is not None
    assert len(new) == len(track.rows)
    assert track.rows.time[-1] - track.rows.time[0] <= KEPT


def test_returned_rows_do_not_change() -> None:
    track = Track(Scores)
    track.add(scores(*range(0, s, 10 * ms)))
    new = track.take()
    assert new is not None
    before = new.time.tolist()
    for second in range(1, 90):
        track.add(scores(*range(second * s, (second + 1) * s, 10 * ms)))
    assert new.time.tolist() == before
