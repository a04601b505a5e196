import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.events import encode
from connectors.web.page_frames import EVENTS_KEPT, FINGERS_MAX, KEPT, STEP, Frames, Seen, Track, rows_json
from operators.batch import EVERY, Faults, Motion, Scores, Touch, Zeroed, ms, s
from operators.health import FaultKind
from operators.ports import Run
from tests.connectors.web.reading import scored, slip

START = 90 * s  # of the run
NOW = 100 * s


@pytest.fixture
def frames(run: Run) -> Frames:
    return Frames(run)


def touch(kind: type[Touch], time: int, count: int, finger: int = 0) -> Touch:
    counts = np.full((1, 6), count, np.int16)
    return kind(np.array([time]), counts, counts, np.ones((1, 6), np.bool_), finger=finger)


def fault(kind: FaultKind, *, active: bool, finger: int = 0) -> Faults:
    cell, kinds = np.array([3], np.int8), np.array([kind], np.int8)
    return Faults(np.array([START]), cell, kinds, np.array([active]), finger=finger)


def frame(frames: Frames, seen: Seen | None = None) -> dict[str, Any]:
    """Return the frame of a browser; by default of a new one."""
    rows, document = frames.since(seen or Seen())
    found: dict[str, Any] = json.loads(encode({**document, "rows": rows_json(rows, START)}))
    return found


def test_a_frame_has_what_is_new_for_its_browser(frames: Frames) -> None:
    one, other = Seen(), Seen()
    frames.add(touch(Zeroed, START + 10 * ms, -7, finger=2))
    frames.add(scored(START + 10 * ms, 0.25, finger=2))
    velocity = np.array([[0.1, 0, 0, 0, 0, 0]])
    frames.add(Motion(np.array([START]), np.array([START]), velocity, np.full((1, 6), np.nan)))
    rest = {"now": 10_000.0, "zeroed": True, "slipping": [], "faults": {}, "quality": {"2": ["good", None]}}
    first = {
        "rows": {
            "touch": {"2": {"t": [10.0], "v": [[-7.0] * 6]}},
            "scores": {"2": {"t": [10.0], "v": [0.25]}},
            "speed": {"every": {"t": [0.0], "v": [100.0]}},
        },
        "events": [],
        **rest,
    }
    assert frame(frames, one) == first
    assert frame(frames, one) == {"rows": {}, "events": [], **rest}
    frames.add(slip(NOW - 8 * ms, 1, finger=1))
    event = {"id": 1, "t": 9_992.0, "finger": "1", "onset": True, "p": 0.9, "quality": ["good", None]}
    for seen, rows in ((one, {}), (other, first["rows"])):
        found = frame(frames, seen)
        assert found["rows"] == rows
        assert found["events"] == [{**event, "latency": 8.0}]
        assert found["slipping"] == ["1"]
    frames.add(slip(NOW, 0, finger=1))
    found = frame(frames, one)
    assert ([each["id"] for each in found["events"]], found["slipping"]) == ([2], [])


def test_zeroed_counts_replace_raw_ones(frames: Frames) -> None:
    seen = Seen()
    frames.add(touch(Touch, START, 700))
    found = frame(frames, seen)
    assert (found["rows"]["touch"]["0"]["v"], found["zeroed"]) == ([[700.0] * 6], False)
    frames.add(touch(Zeroed, START, -3))
    frames.add(touch(Touch, START + 10 * ms, 700))
    for each in (seen, Seen()):
        found = frame(frames, each)
        assert (found["rows"]["touch"]["0"], found["zeroed"]) == ({"t": [0.0], "v": [[-3.0] * 6]}, True)


def test_the_quality_is_that_of_the_newest_score_and_of_the_cells(frames: Frames) -> None:
    frames.add(scored(START, 0.5, finger=1))
    assert frame(frames)["quality"] == {"1": ["good", None]}
    frames.add(fault(FaultKind.STUCK, active=True, finger=1))
    frames.add(fault(FaultKind.DRIFTING, active=False, finger=1))
    frames.add(slip(NOW, 1, finger=1))
    found = frame(frames)
    assert found["quality"] == {"1": ["doubtful", "barometer 3 stuck"]}
    assert [event["quality"][0] for event in found["events"]] == ["doubtful"]
    assert found["faults"] == {"1": {"3": "stuck"}}
    frames.add(fault(FaultKind.STUCK, active=False, finger=1))
    frames.add(scored(START + 10 * ms, np.nan, finger=1))
    found = frame(frames)
    assert (found["quality"], found["faults"]) == ({"1": ["blind", "no probability"]}, {})


def test_a_replay_at_full_speed_has_no_latency(frames: Frames, run: Run) -> None:
    run.live = False
    frames.add(slip(NOW, 1, finger=EVERY))
    [event] = frame(frames)["events"]
    assert (event["latency"], event["finger"]) == (None, "every")


def test_events_and_fingertips_are_bounded(frames: Frames) -> None:
    for k in range(EVENTS_KEPT + 50):
        frames.add(slip(START + k * ms, 1 - k % 2))
    for finger in range(FINGERS_MAX + 9):
        frames.add(touch(Zeroed, START, -1, finger))
        frames.add(scored(START, 0.5, finger=finger))
    found = frame(frames)
    assert [event["id"] for event in found["events"]] == [*range(51, EVENTS_KEPT + 51)]
    assert [len(fingers) for fingers in found["rows"].values()] == [FINGERS_MAX] * 2


def scores(*times: int) -> Scores:
    return Scores(np.array(times, np.int64), np.zeros(len(times)))


@given(st.lists(st.integers(0, 200), max_size=60), st.lists(st.integers(1, 7)))
def test_a_track_keeps_the_first_row_of_each_5_ms_in_order_for_any_batch_cuts(
    times: list[int], cuts: list[int]
) -> None:
    kept = list[int]()
    for time in times:
        if not kept or time * ms // STEP > kept[-1] * ms // STEP:
            kept.append(time)
    track, rest, returned, count = Track(Scores), times, list[int](), 0
    while rest:
        size = cuts.pop() if cuts else len(rest)
        track.add(scores(*(time * ms for time in rest[:size])))
        rest = rest[size:]
        returned += (track.since(count).time // ms).tolist()
        count = track.count
    assert returned == (track.since(0).time // ms).tolist() == kept


def test_a_track_is_bounded_and_returned_rows_do_not_change() -> None:
    track = Track(Scores)
    track.add(scores(*range(0, s, 10 * ms)))
    first = track.since(0)
    before = first.time.tolist()
    for second in range(1, 120):
        track.add(scores(*range(second * s, (second + 1) * s, ms)))
    assert first.time.tolist() == before
    kept = track.since(0)
    assert len(kept) == len(track.since(len(first))) <= KEPT // STEP + 1
    assert kept.time[-1] - kept.time[0] <= KEPT
