import asyncio
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from connectors import Replay
from flows.graph.testing import TestRecording
from flows.run.clocks import EventClock
from operators.batch import Motion, Scores, Touch, ms, s
from operators.errors import InputError


def recorded(times: Mapping[int, list[int]]) -> TestRecording:
    """Scores of several fingertips."""
    batches = (
        Scores(np.array(time, np.int64), np.linspace(0, 1, len(time)), finger=finger)
        for finger, time in times.items()
    )
    return TestRecording("memory", batches)


def replay(source: Replay[Scores], clock: EventClock) -> list[tuple[int, Scores]]:
    """Each batch with the clock's time when it came."""

    async def main() -> list[tuple[int, Scores]]:
        return [(clock.now(), batch) async for batch in source.batches(clock)]

    return asyncio.run(main())


def test_each_row_is_a_batch_when_it_is_due_and_streams_of_one_recording_are_synchronous() -> None:
    source = Replay(recorded({0: [5 * s, 5 * s + 10 * ms, 5 * s + 30 * ms]}), Scores)
    due = [(100 * s + time, 1) for time in (0, 10 * ms, 30 * ms)]
    assert [(now, len(batch)) for now, batch in replay(source, EventClock(100 * s))] == due
    touch = replace(Touch.zeros(1), time=np.array([7 * s]))
    scores = Scores(np.array([9 * s]), np.ones(1), finger=0)
    late = Replay(TestRecording("memory", [touch, scores, Motion.empty()]), Scores)
    assert [now for now, _ in replay(late, EventClock(0))] == [2 * s]


def test_the_chosen_fingertips_are_merged_by_timestamp() -> None:
    recording = recorded({0: [0, 2, 4], 1: [1, 2, 3]})
    both, one = Replay(recording, Scores), Replay(recording, Scores, (1,))
    assert (both.fingers, one.fingers) == ((0, 1), (1,))
    found = [(batch.time.item(), batch.finger) for _, batch in replay(both, EventClock(0))]
    assert found == [(0, 0), (1, 1), (2, 0), (2, 1), (3, 1), (4, 0)]
    assert [batch.time.item() for _, batch in replay(one, EventClock(0))] == [1, 2, 3]


def test_a_name_that_is_not_utf_8_can_be_published() -> None:
    assert Replay(TestRecording("lab/\udcff.csv", []), Scores).recording == "?.csv"


def test_a_missing_stream_cannot_be_replayed() -> None:
    recording = recorded({0: [0]})
    with pytest.raises(InputError, match=r"^memory: has no Motion stream$"):
        _ = Replay(recording, Motion).fingers
    with pytest.raises(InputError, match=r"^memory: has no Scores stream of finger 3; its fingers are 0$"):
        _ = Replay(recording, Scores, (0, 3)).fingers
