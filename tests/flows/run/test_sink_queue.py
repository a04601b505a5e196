"""What a sink does to a live run: it fails, is slow, is stuck."""

import asyncio
import logging

import pytest

from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource, run_virtually
from flows.run.live_runner import LiveRunner
from operators import EndpointError, Run, Scores, s
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


def test_a_second_stop_abandons_failing_sinks_at_once() -> None:
    flow = Flow("f")
    dead = TestSink(failures=[OSError("dead")] * 10_000)
    flow.source(Endless()).to(dead)

    async def main() -> float:
        runner = LiveRunner(flow, "test")
        loop = asyncio.get_running_loop()
        loop.call_later(1, runner.stop)
        loop.call_later(1.5, runner.stop)
        await runner.execute()
        return loop.time()

    assert run_virtually(main()) < 2
    assert dead.closed == 1


def test_a_third_stop_ends_a_run_whose_sink_hangs() -> None:
    async def for_ever() -> None:
        await asyncio.Event().wait()

    flow = Flow("f")
    flow.source(Endless()).to(TestSink(before_write=for_ever))

    async def main() -> Run:
        runner = LiveRunner(flow, "test")
        for after in (1, 2, 3):
            asyncio.get_running_loop().call_later(after, runner.stop)
        return await runner.execute()

    run = run_virtually(main())
    assert run.sinks["testsink"].dropped == run.sources["scores"].rows > 0
    assert "abandoned" in run.sinks["testsink"].error


def test_the_queue_of_an_abandoned_sink_is_dropped() -> None:
    flow, dead = Flow("f"), TestSink(failures=[OSError("dead")] * 10_000)
    flow.source(TestSource(Scores, scores(0, 100))).to(dead)
    status = execute(flow).sinks["testsink"]
    assert (status.rows, status.dropped, status.queued) == (0, 100, 0)
