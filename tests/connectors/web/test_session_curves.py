import asyncio
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from connectors.web import session_page as module
from connectors.web.session_page import SessionCurves
from operators import Debounce
from operators.batch import Faults, Motion, Scores, Slips, Truth, Zeroed, ms, s
from operators.errors import InputError
from operators.health import FaultKind
from operators.ports import Run
from tests.connectors.web.reading import scored, slip, touched
from tests.storage.made import new_samples

START = 90 * s


def kept(run: Run, *batches: Zeroed | Motion | Scores | Slips | Faults | Truth) -> SessionCurves:
    async def main() -> SessionCurves:
        recorded = SessionCurves(Debounce(), "A recorded session.")
        await recorded.open(run)
        for batch in batches:
            await recorded.write(batch)
        await recorded.close()
        return recorded

    return asyncio.run(main())


def cut(recorded: SessionCurves, begin: float, end: float) -> dict[str, Any]:
    found: Any = recorded.window(begin, end, 1000)["rows"]
    return {**found}


def test_a_window_has_the_rows_between_its_ends(run: Run) -> None:
    recorded = kept(run, *[touched(START + k * 10 * ms, -k) for k in range(100)])
    window = cut(recorded, 100, 200)
    assert window["touch 0"]["t"] == [10.0 * k for k in range(10, 21)]
    assert window["touch 0"]["v"][0] == [-10] * 6
    assert [*window] == ["touch 0"]
    assert len(cut(recorded, 0, 1000)["touch 0"]["t"]) == 100
    assert cut(recorded, 5000, 6000)["touch 0"]["t"] == []
    assert cut(recorded, -500, -100)["touch 0"]["t"] == []


def test_the_contents_have_the_length_and_the_events_in_order_of_time(run: Run) -> None:
    stuck = np.array([3], np.int8), np.array([FaultKind.STUCK], np.int8), np.array([True])
    batches: list[Zeroed | Slips | Faults] = [
        touched(START + 50 * ms, -300),
        *[slip(START + at * ms, state) for at, state in ((10, 1), (40, 0))],
        *[slip(START + at * ms, state, finger=2) for at, state in ((5, 1), (40, 0))],
        Faults(np.array([START + 20 * ms]), *stuck, finger=0),
    ]
    contents: dict[str, Any] = {**kept(run, *batches).contents()}
    assert (contents["session"], contents["start"], contents["length"]) == ("run1", 90_000, 50)
    assert (contents["threshold"], contents["scored"]) == (0.5, False)
    names = ("id", "t", "finger", "onset")
    assert [tuple(event[name] for name in names) for event in contents["events"]] == [
        (1, 5, "2", True),
        (2, 10, "0", True),
        (3, 40, "0", False),
        (4, 40, "2", False),
    ]
    assert [event["quality"][0] for event in contents["events"]] == ["good", "good", "doubtful", "good"]


def test_faults_and_quality_are_those_of_the_time(run: Run) -> None:
    stuck = np.array([3], np.int8), np.array([FaultKind.STUCK], np.int8), np.array([True])
    fault = Faults(np.array([START + 50 * ms]), *stuck, finger=0)
    scores = [scored(START + k * 10 * ms, k / 10) for k in range(10)]
    recorded, marked = kept(run, touched(START - 2 * s, -7), *scores, fault), {"0": {"3": "stuck"}}
    for at, time, faults, quality in (
        (45, [40], {}, "good"),
        (60, [60], marked, "doubtful"),
        (-1, [], {}, None),
    ):
        found: dict[str, Any] = {**recorded.window(at - 1000, at, None)}
        assert (found["faults"], found["quality"].get("0", [None])[0]) == (faults, quality)
        assert found["rows"]["scores 0"]["t"] == time
    assert found["rows"]["touch 0"]["t"] == [], "its row is too old"


def test_labels_and_truth_are_runs_that_end_where_the_value_changes_or_a_pause_begins(run: Run) -> None:
    at = START + np.array([0, 10, 20, 30, 1000]) * ms
    labelled = replace(new_samples(at, finger=3), label=np.array([0, 0, 1, 1, 1], np.int8))
    sliding = np.zeros(100)
    sliding[20:40] = sliding[45:60] = 0.02  # the stick phase between them is part of the slip
    time = START + np.arange(100) * 10 * ms
    truth = Truth(time, sliding, sliding, np.zeros((100, 3)), finger=3)
    contents: dict[str, Any] = {**kept(run, labelled, truth).contents()}
    assert contents["bands"] == {
        "label 3": [[0, 20, 0], [20, 30, 1], [1000, 1000, 1]],
        "truth 3": [[0, 200, 0], [200, 600, 1], [600, 990, 0]],
    }


def test_a_session_too_long_for_memory_is_rejected(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "ROWS_MAX", 2)
    with pytest.raises(InputError, match="run1: is too long for a page, which shows at most 2 rows"):
        kept(run, *[touched(START + k * ms, -1) for k in range(3)])
