import json
from typing import Any

import numpy as np
import pytest

from connectors.events import encode
from connectors.web.live_page import EVENTS_KEPT, KEPT, STEP, Frames, rows_json
from operators.batch import EVERY, Scores, Touch, ms, s
from operators.health import FaultKind
from operators.ports import Run
from tests.connectors.web.reading import fault, moved, scored, slip, touched

START = 90 * s  # of the run
NOW = 100 * s


@pytest.fixture
def frames(run: Run) -> Frames:
    return Frames(run, zeroed=True)


def frame(frames: Frames, seen: int = -1) -> dict[str, Any]:
    """Return the frame of a browser; by default of a new one."""
    rows, document = frames.since(seen)
    found: dict[str, Any] = json.loads(encode({**document, "rows": rows_json(rows, START)}))
    return found


def test_a_frame_has_what_is_new_for_its_browser(frames: Frames) -> None:
    zeroed = touched(START + 10 * ms, -7, finger=2)
    frames.add(Touch(zeroed.time, zeroed.counts, zeroed.temperature, zeroed.valid, finger=2))  # is ignored
    frames.add(zeroed)
    frames.add(scored(START + 10 * ms, 0.25, finger=2))
    frames.add(moved(START))
    rest = {"now": 10_000.0, "slipping": [], "faults": {}, "quality": {"2": ["good", None]}}
    rows = {
        "touch 2": {"t": [10.0], "v": [[-7.0] * 6]},
        "scores 2": {"t": [10.0], "v": [0.25]},
        "speed every": {"t": [0.0], "v": [3.0]},
    }
    assert frame(frames) == {"rows": rows, "events": [], **rest}
    seen = frames.count
    assert frame(frames, seen) == {"rows": {}, "events": [], **rest}
    frames.add(slip(NOW - 8 * ms, 1, finger=1))
    event = {"id": 1, "t": 9_992.0, "finger": "1", "onset": True, "p": 0.9, "quality": ["good", None]}
    for before, new in ((seen, {}), (-1, rows)):
        found = frame(frames, before)
        assert (found["rows"], found["events"]) == (new, [{**event, "latency": 8.0}])
        assert found["slipping"] == ["1"]
    seen = frames.count
    frames.add(slip(NOW, 0, finger=1))
    found = frame(frames, seen)
    assert ([each["id"] for each in found["events"]], found["slipping"]) == ([2], [])


def test_a_late_row_is_shown_in_order_of_time(frames: Frames) -> None:
    for at in (200, 100):  # so that the newest batch ends before the first begins
        frames.add(scored(START + at * ms, at / 1000))
    assert frame(frames)["rows"] == {"scores 0": {"t": [100.0, 200.0], "v": [0.1, 0.2]}}


def test_the_quality_is_that_of_the_newest_score_and_of_the_cells(frames: Frames) -> None:
    frames.add(scored(START, 0.5, finger=1))
    assert frame(frames)["quality"] == {"1": ["good", None]}
    frames.add(fault(START, 3, FaultKind.STUCK, finger=1))
    frames.add(fault(START, 3, FaultKind.DRIFTING, begins=False, finger=1))
    frames.add(slip(NOW, 1, finger=1))
    found = frame(frames)
    assert found["quality"] == {"1": ["doubtful", "barometer 3 stuck"]}
    assert [event["quality"][0] for event in found["events"]] == ["doubtful"]
    assert found["faults"] == {"1": {"3": "stuck"}}
    frames.add(fault(START, 3, FaultKind.STUCK, begins=False, finger=1))
    frames.add(scored(START + 10 * ms, np.nan, finger=1))
    found = frame(frames)
    assert (found["quality"], found["faults"]) == ({"1": ["blind", "no probability"]}, {})


def test_events_are_bounded_and_a_replay_at_full_speed_has_no_latency(frames: Frames, run: Run) -> None:
    run.live = False
    for k in range(EVENTS_KEPT + 50):
        frames.add(slip(START + k * ms, 1 - k % 2, finger=EVERY))
    found = frame(frames)["events"]
    assert [event["id"] for event in found] == [*range(51, EVENTS_KEPT + 51)]
    assert {(event["latency"], event["finger"]) for event in found} == {(None, "every")}


def test_rows_are_bounded_and_many_in_5_ms_are_reduced_to_their_extremes(frames: Frames) -> None:
    batches = 0
    for second in range(120):
        time = START + second * s + np.arange(0, s, ms // 4)  # 20 in each 5 ms
        for part in np.split(time, 4):
            frames.add(Scores(part, np.sin(part / s)))
            batches += 1
    rows, _ = frames.since(-1)
    assert sum(len(each.time) for each in rows) <= (KEPT + s) // (ms // 4)
    [curve] = rows_json(rows, START).values()
    assert isinstance(curve, dict)
    times: Any = curve["t"]
    assert len(times) <= 2 * ((KEPT + s) // STEP)
    assert [times[0], times[-1]] == [rows[0].time[0] / ms - START / ms, 120_000 - 0.25]
    assert [each.number for each in frames.since(batches - 1)[0]] == [batches]
