import asyncio
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from connectors.web import session_page as module
from connectors.web.session_page import SessionCurves
from operators.batch import Motion, Scores, Slips, Zeroed, ms, s
from operators.errors import InputError
from operators.ports import Run
from tests.connectors.web.reading import slip, touched

START = 90 * s


def kept(run: Run, *batches: Zeroed | Motion | Scores | Slips) -> SessionCurves:
    async def main() -> SessionCurves:
        recorded = SessionCurves(about="A recorded session.", flow="record", dataset="lab")
        await recorded.open(run)
        for batch in batches:
            await recorded.write(batch)
        await recorded.close()
        return recorded

    return asyncio.run(main())


def cut(recorded: SessionCurves, begin: float, end: float) -> dict[str, Any]:
    return {**recorded.window(begin, end, 1000)}


def test_a_window_has_the_rows_between_its_ends(run: Run) -> None:
    recorded = kept(run, *[touched(START + k * 10 * ms, -k) for k in range(100)])
    window = cut(recorded, 100, 200)
    assert window["touch"]["0"]["t"] == [10.0 * k for k in range(10, 21)]
    assert window["touch"]["0"]["v"][0] == [-10] * 6
    assert window["touch"]["0"]["zeroed"]
    assert window["speed"] is None
    assert cut(recorded, 5000, 6000)["touch"]["0"]["t"] == []
    assert cut(recorded, -500, -100)["touch"]["0"]["t"] == []


def test_a_long_window_is_thinned_to_the_pixels_and_keeps_its_peak(run: Run) -> None:
    rows = 100_000
    time = START + np.arange(rows) * 10 * ms
    probability = np.zeros(rows)
    probability[54_321] = 0.875
    scores = cut(kept(run, Scores(time, probability, finger=0)), 0, 1e6)["scores"]["0"]
    assert len(scores["t"]) == 2000
    assert max(scores["v"]) == 0.875
    at = scores["v"].index(0.875)
    assert scores["t"][at - 1] <= 543_210 <= scores["t"][at]


def test_values_at_a_time_are_not_thinned(run: Run) -> None:
    time = START + np.arange(100_000) * 10 * ms
    recorded = kept(run, Scores(time, np.arange(100_000) % 100 / 100, finger=0), touched(START, -7))
    seen: dict[str, Any] = {**recorded.values_at(543_215)}
    assert seen["scores"]["0"] == {"t": [543_210], "v": [pytest.approx(0.21)]}
    assert seen["touch"]["0"]["t"] == []  # its last row is too old
    assert seen["speed"] is None
    before: dict[str, Any] = {**recorded.values_at(-1)}
    assert before["scores"]["0"]["t"] == []


def test_the_scale_of_the_pressure_maps_ignores_a_dead_fingertip(run: Run) -> None:
    dead, alive = touched(START, -7, finger=0), touched(START, -40, finger=1)
    dead = replace(dead, valid=np.zeros_like(dead.valid))
    for batches in ((dead, alive), (alive, dead)):
        assert kept(run, *batches).contents()["deepest"] == -40
    assert kept(run, dead).contents()["deepest"] is None


def test_the_contents_have_the_span_the_fingertips_and_all_events(run: Run) -> None:
    batches: list[Zeroed | Slips] = [
        touched(START + 10 * ms, -40, finger=1),
        touched(START, -300, finger=0),
        slip(START + 20 * ms, 1, finger=1),
    ]
    contents: dict[str, Any] = {**kept(run, *batches).contents()}
    assert contents["fingers"] == ["0", "1"]
    assert (contents["start"], contents["length"]) == (90_000, 20)
    assert (contents["flow"], contents["dataset"], contents["session"]) == ("record", "lab", "run1")
    assert (contents["threshold"], contents["deepest"], contents["zeroed"]) == (0.5, -300, True)
    [event] = contents["events"]
    assert (event["t"], event["finger"], event["onset"], event["latency"]) == (20, "1", True, None)


def test_events_of_several_fingertips_are_sorted_and_numbered_by_time(run: Run) -> None:
    times = {0: (10, 40), 1: (20, 30), 2: (5, 40)}
    batches = [
        slip(START + at * ms, state, finger=finger)
        for finger, both in times.items()
        for at, state in zip(both, (1, 0), strict=True)
    ]
    found: dict[str, Any] = {**kept(run, *batches).contents()}
    events = [(event["id"], event["t"], event["finger"], event["onset"]) for event in found["events"]]
    assert events == [
        (1, 5, "2", True),
        (2, 10, "0", True),
        (3, 20, "1", True),
        (4, 30, "1", False),
        (5, 40, "0", False),
        (6, 40, "2", False),
    ]


def test_late_rows_are_dropped_from_a_curve(run: Run) -> None:
    batches = [touched(START + k * ms, -1) for k in (0, 20, 10, 30)]
    assert cut(kept(run, *batches), 0, 100)["touch"]["0"]["t"] == [0, 20, 30]


def test_an_always_invalid_cell_does_not_scale_the_maps(run: Run) -> None:
    touch = touched(START, -5)
    silent = Zeroed(touch.time, touch.counts, touch.temperature, np.zeros((1, 6), np.bool_), finger=0)
    assert kept(run, silent).contents()["deepest"] is None


def test_a_session_too_long_for_memory_is_rejected(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "ROWS_MAX", 2)
    with pytest.raises(InputError, match="run1: is too long for a page, which shows at most 2 rows"):
        kept(run, *[touched(START + k * ms, -1) for k in range(3)])
