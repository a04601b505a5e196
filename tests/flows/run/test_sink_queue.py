"""What a sink does to a live run: it fails, is slow, is stuck."""

import asyncio
import logging
from collections import deque
from collections.abc import Callable, Coroutine
from typing import Any, Final

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from flows.run.live_runner import LiveRunner
from flows.run.run_summary import Summary
from operators import (
    Batch,
    Debounce,
    EndpointError,
    Operator,
    OperatorError,
    OutputClosedError,
    Run,
    Scores,
    Sink,
    ms,
    s,
)
from tests.flows.run.live import Endless, FaultySink, execute, flow_of, scores, times

ROWS: Final = 60
DOWN: Final = EndpointError("x", "down")


class Moody(TestSink):
    """Sink that takes batches at once, lets them wait (s) or fails, as its moods say in turn."""

    def __init__(self, moods: list[float | None], *, lossless: bool, capacity: int) -> None:
        super().__init__()
        self.lossless, self.capacity = lossless, capacity
        self.moods = deque(moods)

    def take(self, batch: Batch) -> bool:
        if self.moods and self.moods[0]:
            return False
        self._react()
        self.written.append(batch)
        return True

    async def write(self, batch: Batch) -> None:
        await asyncio.sleep((self.moods and self.moods[0]) or 0)
        self._react()
        self.written.append(batch)

    def _react(self) -> None:
        if self.moods and self.moods.popleft() is None:
            raise DOWN


moods = st.lists(st.sampled_from([0.0, 0.0, 0.0, 0.005, 0.025, 0.2, None]), max_size=ROWS)


@given(
    given_moods=moods,
    lossless=st.booleans(),
    capacity=st.integers(1, 8),
    stops=st.sampled_from([(), (0.3,), (0.3, 0.31)]),
)
def test_rows_are_written_once_in_order_or_counted_as_dropped_and_other_sinks_get_all(
    *, given_moods: list[float | None], lossless: bool, capacity: int, stops: tuple[float, ...]
) -> None:
    moody, other = Moody(given_moods, lossless=lossless, capacity=capacity), TestSink()
    run = execute(flow_of(TestSource(Scores, scores(0, ROWS)), moody, other), stops=stops)
    status, rows = run.sinks["moody"], run.sources["scores"].rows
    assert times(other) == list(range(rows - run.sinks["testsink"].dropped))
    assert not run.sinks["testsink"].dropped or len(stops) == 2
    assert times(moody) == sorted(set(times(moody)))
    assert (status.rows, status.rows + status.dropped, status.queued) == (len(moody.written), rows, 0)
    assert bool(status.failures) == (given_moods.count(None) > moody.moods.count(None))
    assert moody.closed == 1
    if lossless and not status.failures and len(stops) < 2:
        assert not status.dropped
    if not status.dropped:
        assert (status.error, times(moody)) == ("", list(range(rows)))


def test_a_sink_that_neither_takes_nor_writes_is_reported() -> None:
    class Choosy(Sink[Scores]):
        @property
        def destination(self) -> str:
            return "nowhere"

        async def open(self, run: Run) -> None:
            pass

        def take(self, batch: Scores) -> bool:
            return batch.time.item(0) < 50 * ms

    status = execute(flow_of(TestSource(Scores, scores(0, 10)), Choosy())).sinks["choosy"]
    assert (status.rows, status.dropped) == (5, 5)
    assert "Choosy must implement `write`, as its `take` returned False" in status.error


@pytest.mark.parametrize("before_write", [None, lambda: asyncio.sleep(0.002)], ids=["take", "write"])
def test_a_mistake_in_a_sink_ends_the_run_at_once_with_its_place(
    before_write: Callable[[], Coroutine[Any, Any, None]] | None, caplog: pytest.LogCaptureFixture
) -> None:
    wrong, other = FaultySink(failures=[None, KeyError("row")], before_write=before_write), TestSink()
    with pytest.raises(OperatorError, match=r"^flow 'f': faultysink: KeyError: 'row' \(live\.py:\d+\)$"):
        execute(flow_of(Endless(), wrong, other))
    assert (len(wrong.written), wrong.closed, other.closed) == (1, 1, 1)
    assert 2 <= len(other.written) <= 3
    assert "KeyError" in other.run.error
    assert other.run.sinks["faultysink"].dropped == len(other.written) - 1
    assert not caplog.messages


def test_a_mistake_in_a_sink_at_the_end_of_the_streams_is_an_error_too() -> None:
    class Held(Operator[Scores, Scores]):
        def process(self, batch: Scores) -> Scores:
            return Scores.empty()

        def flush(self) -> Scores:
            return scores(9, 1)[0]

    wrong = FaultySink(failures=[KeyError("row")])
    with pytest.raises(OperatorError, match=r"faultysink: KeyError: 'row'"):
        execute(flow_of(TestSource(Scores, scores(0, 3)), wrong, through=[Held()]))


async def for_ever() -> None:
    await asyncio.Event().wait()


def test_a_closed_output_ends_the_run_orderly_and_quietly(caplog: pytest.LogCaptureFixture) -> None:
    for waiting in (False, True):
        closed = FaultySink(failures=[None, OutputClosedError("stdout", "was closed")])
        other = FaultySink(before_write=(lambda: asyncio.sleep(0.5)) if waiting else None)
        run = execute(flow_of(Endless(), closed, other))
        assert (len(closed.written), closed.closed, other.closed, run.error) == (1, 1, 1, "")
        assert len(other.written) == run.sources["scores"].rows >= 2
        assert run.sinks["faultysink"].dropped == run.sources["scores"].rows - 1
    assert not caplog.records


def test_a_stuck_lossless_sink_blocks_no_other_and_works_again(caplog: pytest.LogCaptureFixture) -> None:
    waits, other = [60.0], TestSink()
    stuck = FaultySink(capacity=10, before_write=lambda: asyncio.sleep(waits.pop() if waits else 0))
    with caplog.at_level(logging.INFO, "slipflow"):
        status = execute(flow_of(TestSource(Scores, scores(0, 9000)), stuck, other)).sinks["faultysink"]
    kept = times(stuck)
    assert times(other) == list(range(9000))
    assert (kept[:11], kept[-1]) == (list(range(11)), 8999)
    assert (status.dropped, status.error) == (9000 - len(kept), "")
    assert status.dropped > 2500
    assert [text.partition(":")[0] for text in caplog.messages] == [
        "faultysink failed",
        "faultysink drops rows until it works again",
        f"faultysink works again; {9000 - len(kept)} rows were dropped",
    ]


@pytest.mark.parametrize("lossless", [True, False])
def test_a_sink_whose_queue_has_room_counts_as_failing_while_a_write_hangs(lossless: bool) -> None:
    seen = list[str]()
    waits, rare = [25.0], TestSource(Scores, [Scores.rows([k * 9 * s], 0.9) for k in range(5)])
    sink = FaultySink(lossless=lossless, before_write=lambda: asyncio.sleep(waits.pop() if waits else 0))

    def look(runner: LiveRunner, _: object) -> None:
        seen.append(runner.run.sinks["faultysink"].error)

    status = execute(flow_of(rare, sink), at=dict.fromkeys((5.0, 15.0, 30.0), look)).sinks["faultysink"]
    assert [error.partition(": ")[2] for error in seen] == ["", "has not completed a write for 10 s", ""]
    assert (status.rows, status.dropped, status.failures) == (5, 0, 1)


def test_a_slow_sink_that_may_drop_loses_its_oldest_and_counts_them() -> None:
    slow = FaultySink(capacity=3, before_write=lambda: asyncio.sleep(0.05), lossless=False)
    dropped = execute(flow_of(TestSource(Scores, scores(0, 100)), slow)).sinks["faultysink"].dropped
    assert dropped > 50
    assert len(times(slow)) + dropped == 100
    assert times(slow)[-3:] == [97, 98, 99]


@pytest.mark.parametrize(
    "sink",
    [
        FaultySink(failures=[OSError("dead")] * 10_000),
        FaultySink(before_write=for_ever),
        FaultySink(before_write=for_ever, capacity=1),
    ],
    ids=["fails", "hangs", "is full"],
)
def test_a_second_stop_abandons_a_sink_and_counts_all_rows_as_dropped(sink: TestSink) -> None:
    flow = Flow("f")
    stream = flow.source(Endless())
    stream.to(sink)
    (stream | Debounce(consecutive=2)).to(sink)  # gives a row at the end
    run = execute(flow, stops=(1, 2))
    assert run.clock.now() - run.start < 5 * s
    assert run.sinks["faultysink"].dropped == run.sources["scores"].rows + 1 > 1
    assert run.sinks["faultysink"].error
    assert Summary.of(run).error


class Disk(TestSink):
    """Sink that accepts rows and stores them, slowly, when it is closed."""

    stored = 0

    @property
    def pending(self) -> int:
        return len(self.written) - self.stored

    async def close(self) -> None:
        while self.pending:
            await asyncio.sleep(0.1)
            self.stored += 1
        await super().close()


def test_the_end_of_a_run_waits_for_a_slow_sink_and_reports_it(caplog: pytest.LogCaptureFixture) -> None:
    slow = Disk()
    with caplog.at_level(logging.INFO, "slipflow"):
        run = execute(flow_of(TestSource(Scores, scores(0, 120)), slow))
    assert caplog.messages == [
        f"waiting for disk (0 batches queued, {rows} rows not stored); a second signal drops them"
        for rows in (70, 20)
    ]
    assert (run.sinks["disk"].rows, run.sinks["disk"].dropped, slow.closed) == (120, 0, 1)
    assert not Summary.of(run).error


class Finishing(Disk):
    """Disk whose last write takes 10 s and cannot be stopped."""

    async def close(self) -> None:
        try:
            await super().close()
        finally:
            await asyncio.sleep(10)
            self.stored: int = self.stored + 1


@pytest.mark.parametrize(("slow", "stops", "end"), [(Disk(), (3, 4), 5), (Finishing(), (3, 4, 5), 15)])
def test_further_stops_report_the_exact_number_of_rows_that_a_slow_sink_lost(
    slow: Disk, stops: tuple[float, ...], end: int
) -> None:
    run = execute(flow_of(Endless(), slow), stops=stops)
    [status] = run.sinks.values()
    assert (status.rows, status.dropped) == (slow.stored, run.sources["scores"].rows - slow.stored)
    assert slow.stored > 10
    assert Summary.of(run).error
    assert run.clock.now() - run.start >= end * s


def test_the_status_of_a_run_has_the_numbers_of_waiting_and_unstored_rows_and_the_connection() -> None:
    seen = list[tuple[int | None, int, bool | None]]()

    class Unstored(TestSink):
        connected = True

        @property
        def waiting(self) -> int:
            return 7 + self.closed

        @property
        def pending(self) -> int:
            return 5

        async def close(self) -> None:
            status = self.run.sinks["unstored"]
            seen.append((status.waiting, status.unstored, status.connected))
            await super().close()

    status = execute(flow_of(Endless(), Unstored()), duration=3 * s).sinks["unstored"]
    assert seen == [(7, 5, True)]
    assert (status.waiting, status.unstored, status.dropped) == (3, 0, 5)
