"""What a sink does to a live run: it fails, is slow, is stuck."""

import asyncio
import logging
from collections.abc import AsyncIterator

import pytest

from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource, run_virtually
from flows.run.live_runner import LiveRunner
from flows.run.run_summary import Summary
from operators import Batch, Clock, Debounce, EndpointError, OutputClosedError, Run, Scores, Sink, ms, s
from tests.flows.run.live import Endless, execute, scores, times


def test_a_failing_sink_is_retried_with_the_same_batch_and_loses_nothing() -> None:
    flow = Flow("f")
    failing, other = (
        TestSink(failures=[None, EndpointError("x", "down"), EndpointError("x", "down")]),
        TestSink(),
    )
    stream = flow.source(TestSource(Scores, scores(0, 100)))
    stream.to(failing)
    stream.to(other)
    run = execute(flow)
    assert times(failing) == times(other) == list(range(100))
    status = run.sinks["testsink"]
    assert (status.failures, status.dropped, status.error) == (2, 0, "")


class SometimesWaiting(TestSink):
    """Sink that takes three batches out of four at once."""

    def take(self, batch: Batch) -> bool:
        return self._number(batch) % 4 != 3 and super().take(batch)

    async def write(self, batch: Batch) -> None:
        if self._number(batch) % 4 == 3:
            await asyncio.sleep(0.025)  # longer than until the next two batches
        self._keep(batch)

    def _number(self, batch: Batch) -> int:
        return batch.time.item(0)


def test_a_batch_behind_a_waiting_one_waits_too() -> None:
    flow = Flow("f")
    sink = SometimesWaiting(failures=[None] * 5 + [OSError("full")])
    flow.source(TestSource(Scores, scores(0, 100))).to(sink)
    run = execute(flow)
    assert times(sink) == list(range(100))
    status = run.sinks["sometimeswaiting"]
    assert (status.rows, status.failures, status.dropped, status.error) == (100, 1, 0, "")


def test_a_batch_that_is_taken_is_written_when_the_source_goes_on() -> None:
    flow, sink, seen = Flow("f"), TestSink(), list[int]()

    class Watching(TestSource[Scores]):
        async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
            async for batch in super().batches(clock):
                yield batch
                seen.append(len(sink.written))

    flow.source(Watching(Scores, scores(0, 10))).to(sink)
    execute(flow)
    assert seen == list(range(1, 11))


def test_a_sink_that_neither_takes_nor_writes_is_reported() -> None:
    class Choosy(Sink[Scores]):
        @property
        def destination(self) -> str:
            return "nowhere"

        async def open(self, run: Run) -> None:
            pass

        def take(self, batch: Scores) -> bool:
            return batch.time.item(0) < 50 * ms

    flow = Flow("f")
    flow.source(TestSource(Scores, scores(0, 10))).to(Choosy())
    status = execute(flow).sinks["choosy"]
    assert (status.rows, status.dropped) == (5, 5)
    assert "Choosy must implement `write`, as its `take` returned False" in status.error


def test_a_closed_output_ends_the_run_orderly_and_quietly(caplog: pytest.LogCaptureFixture) -> None:
    for waiting in (None, for_ever):
        flow = Flow("f")
        closed = TestSink(failures=[None, OutputClosedError("stdout", "was closed")])
        other = TestSink(before_write=waiting and (lambda: asyncio.sleep(0.5)))
        stream = flow.source(Endless())
        stream.to(closed)
        stream.to(other)
        run = execute(flow)
        assert (len(closed.written), closed.closed, other.closed, run.error) == (1, 1, 1, "")
        assert len(other.written) == run.sources["scores"].rows >= 2
        assert run.sinks["testsink"].dropped == run.sources["scores"].rows - 1
    assert not caplog.records


def test_a_sink_that_never_works_blocks_no_other_and_its_rows_are_counted() -> None:
    flow = Flow("f")
    dead, other = TestSink(failures=[OSError("dead")] * 10_000, capacity=10), TestSink()
    stream = flow.source(TestSource(Scores, scores(0, 1000)))
    stream.to(dead)
    stream.to(other)
    run = execute(flow)
    assert times(other) == list(range(1000))
    assert run.sinks["testsink"].dropped == 1000
    assert run.sinks["testsink"].error == "dead"


def test_a_slow_lossless_sink_makes_the_source_wait_and_gets_everything() -> None:
    flow = Flow("f")

    async def slowly() -> None:
        await asyncio.sleep(0.05)  # five times slower than the source

    slow = TestSink(capacity=3, before_write=slowly)
    flow.source(TestSource(Scores, scores(0, 100))).to(slow)
    run = execute(flow)
    assert times(slow) == list(range(100))
    assert run.sinks["testsink"].dropped == 0


def test_a_stuck_lossless_sink_counts_as_failing_and_does_not_block_the_others() -> None:
    flow, other = Flow("f"), TestSink()
    stuck = TestSink(capacity=10, before_write=lambda: asyncio.sleep(60))
    stream = flow.source(TestSource(Scores, scores(0, 3000)))
    stream.to(stuck)
    stream.to(other)
    run = execute(flow, duration=30 * s)
    assert times(other) == list(range(3000))
    status = run.sinks["testsink"]
    assert status.rows + status.dropped == 3000
    assert status.dropped > 2500
    assert status.failures >= 1


def test_a_stuck_sink_works_again_once_its_write_ends(caplog: pytest.LogCaptureFixture) -> None:
    flow, waits = Flow("f"), [60.0]
    sink = TestSink(capacity=10, before_write=lambda: asyncio.sleep(waits.pop() if waits else 0))
    flow.source(TestSource(Scores, scores(0, 9000))).to(sink)
    with caplog.at_level(logging.WARNING):
        run = execute(flow)
    kept = times(sink)
    assert kept[:11] == list(range(11))
    assert kept[-1] == 8999
    assert run.sinks["testsink"].dropped == 9000 - len(kept)
    assert not run.sinks["testsink"].error
    assert [record.message.partition(":")[0] for record in caplog.records] == [
        "testsink failed",
        "testsink drops rows until it works again",
        f"testsink works again; {9000 - len(kept)} rows were dropped",
    ]


def test_a_slow_sink_that_may_drop_loses_its_oldest_and_counts_them() -> None:
    flow = Flow("f")

    async def slowly() -> None:
        await asyncio.sleep(0.05)

    slow, other = TestSink(capacity=3, before_write=slowly, lossless=False), TestSink()
    stream = flow.source(TestSource(Scores, scores(0, 100)))
    stream.to(slow)
    stream.to(other)
    run = execute(flow)
    dropped = run.sinks["testsink"].dropped
    assert times(other) == list(range(100))
    assert dropped > 50
    assert len(times(slow)) + dropped == 100
    assert times(slow)[-3:] == [97, 98, 99]


async def for_ever() -> None:
    await asyncio.Event().wait()


def stopped_twice(flow: Flow, *, after: float = 1, again: float = 1) -> tuple[Run, float]:
    """A run that is stopped `after` s and `again` s later, and its length in s."""

    async def main() -> tuple[Run, float]:
        runner, loop = LiveRunner(flow, "test"), asyncio.get_running_loop()
        loop.call_later(after, runner.stop)
        loop.call_later(after + again, runner.stop)
        return await runner.execute(), loop.time()

    return run_virtually(main())


def test_a_second_stop_abandons_failing_sinks_at_once() -> None:
    flow = Flow("f")
    dead = TestSink(failures=[OSError("dead")] * 10_000)
    flow.source(Endless()).to(dead)
    run, seconds = stopped_twice(flow)
    assert seconds < 2.5
    assert dead.closed == 1
    assert run.sinks["testsink"].dropped == run.sources["scores"].rows > 0


def test_a_second_stop_ends_a_run_whose_sink_hangs_and_counts_all_rows_as_dropped() -> None:
    flow = Flow("f")
    flow.source(Endless()).to(TestSink(before_write=for_ever))
    run, seconds = stopped_twice(flow)
    assert seconds < 5
    assert run.sinks["testsink"].dropped == run.sources["scores"].rows > 0
    assert "was abandoned" in run.sinks["testsink"].error
    assert Summary.of(run).lost


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
    flow, slow = Flow("f"), Disk()
    flow.source(TestSource(Scores, scores(0, 120))).to(slow)
    with caplog.at_level(logging.WARNING):
        run = execute(flow)
    assert [record.message for record in caplog.records] == [
        f"waiting for disk (0 batches queued, {rows} rows not stored); a second signal drops them"
        for rows in (70, 20)
    ]
    assert (run.sinks["disk"].rows, run.sinks["disk"].dropped, slow.closed) == (120, 0, 1)
    assert not Summary.of(run).lost


def test_a_second_stop_reports_the_exact_number_of_rows_that_a_slow_sink_lost() -> None:
    flow, slow = Flow("f"), Disk()
    flow.source(Endless()).to(slow)
    run, _ = stopped_twice(flow, after=3)
    status = run.sinks["disk"]
    assert (status.rows, status.dropped) == (slow.stored, run.sources["scores"].rows - slow.stored)
    assert slow.stored > 10
    assert Summary.of(run).lost


def test_a_third_stop_does_not_interrupt_the_last_write_of_an_abandoned_sink() -> None:
    class Finishing(Disk):
        async def close(self) -> None:
            try:
                await super().close()
            finally:
                await asyncio.sleep(10)  # a write in progress, which cannot be stopped
                self.stored: int = self.stored + 1

    async def main() -> None:
        runner, loop = LiveRunner(flow, "test"), asyncio.get_running_loop()
        for when in (3, 4, 5):
            loop.call_later(when, runner.stop)
        status = (await runner.execute()).sinks["finishing"]
        assert (status.rows, status.dropped) == (slow.stored, runner.run.sources["scores"].rows - slow.stored)
        assert loop.time() > 15

    flow, slow = Flow("f"), Finishing()
    flow.source(Endless()).to(slow)
    run_virtually(main())


def test_rows_that_come_after_a_second_stop_are_counted_as_dropped() -> None:
    flow, hung = Flow("f"), TestSink(capacity=1, before_write=for_ever)
    stream = flow.source(Endless())
    stream.to(hung)
    (stream | Debounce(consecutive=2)).to(hung)  # gives a row at the end
    run, _ = stopped_twice(flow, again=0)
    assert run.sinks["testsink"].dropped == run.sources["scores"].rows + 1


def test_the_queue_of_an_abandoned_sink_is_dropped() -> None:
    flow, dead = Flow("f"), TestSink(failures=[OSError("dead")] * 10_000)
    flow.source(TestSource(Scores, scores(0, 100))).to(dead)
    status = execute(flow).sinks["testsink"]
    assert (status.rows, status.dropped, status.queued) == (0, 100, 0)


class Exiting(TestSink):
    """Sink that calls sys.exit where it is told to."""

    def __init__(self, where: str) -> None:
        super().__init__()
        self.where = where

    async def open(self, run: Run) -> None:
        self._exit("open")
        await super().open(run)

    def take(self, batch: Batch) -> bool:
        self._exit("take")
        return self.where != "write" and super().take(batch)

    async def write(self, batch: Batch) -> None:
        self._exit("write")
        await super().write(batch)

    async def close(self) -> None:
        self._exit("close")
        await super().close()

    def _exit(self, where: str) -> None:
        if where == self.where:
            raise SystemExit(0)


@pytest.mark.parametrize("where", ["take", "write", "close"])
def test_a_sink_that_calls_sys_exit_has_failed_and_the_run_goes_on(where: str) -> None:
    flow, exiting, other = Flow("f"), Exiting(where), TestSink()
    stream = flow.source(TestSource(Scores, scores(0, 20)))
    stream.to(exiting)
    stream.to(other)
    run = execute(flow)
    assert times(other) == list(range(20))
    assert run.sinks["exiting"].error.endswith("calls sys.exit(0)") == (where != "take")
    assert run.sinks["exiting"].failures
    assert Summary.of(run).lost == (where != "take")  # a batch that was not taken is written


def test_a_sink_that_calls_sys_exit_when_it_opens_ends_the_run_with_its_error() -> None:
    flow = Flow("f")
    flow.source(Endless()).to(Exiting("open"))
    with pytest.raises(EndpointError, match=r"calls sys\.exit\(0\)"):
        execute(flow)


def test_the_status_at_the_end_has_the_newest_number_of_waiting_rows() -> None:
    class Waiting(TestSink):
        @property
        def waiting(self) -> int:
            return len(self.written)

    flow = Flow("f")
    flow.source(TestSource(Scores, scores(0, 150))).to(Waiting())
    assert execute(flow).sinks["waiting"].waiting == 150


def test_the_status_of_a_run_has_the_numbers_of_waiting_and_unstored_rows() -> None:
    seen = list[tuple[int | None, int]]()

    class Unstored(TestSink):
        @property
        def waiting(self) -> int:
            return 7

        @property
        def pending(self) -> int:
            return 5

        async def close(self) -> None:
            status = self.run.sinks["unstored"]
            seen.append((status.waiting, status.unstored))

    flow = Flow("f")
    flow.source(Endless()).to(Unstored())
    run = execute(flow, duration=3 * s)
    assert seen == [(7, 5)]
    assert (run.sinks["unstored"].unstored, run.sinks["unstored"].dropped) == (0, 5)
