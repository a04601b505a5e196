import asyncio
import gc
import logging
import math
import os
import re
import signal
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from threading import Thread
from typing import Any

import numpy as np
import pytest

from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource, VirtualLoop, run_virtually
from flows.run.clocks import LoopClock
from flows.run.live_runner import LiveRunner
from flows.run.run_summary import Summary
from flows.run.sink_queue import SinkQueue
from operators import (
    Align,
    Batch,
    Clock,
    Debounce,
    EndpointError,
    InputError,
    Join,
    Motion,
    OperatorError,
    ParameterError,
    Run,
    Sample,
    Scores,
    SlipflowError,
    Slips,
    Source,
    Touch,
    Zero,
    ms,
    s,
)
from tests.flows.run.live import Endless, execute, scores, times


def test_a_run_ends_when_its_sources_end_and_closes_its_sinks() -> None:
    flow, sink = Flow("f"), TestSink()
    flow.source(TestSource(Scores, scores(0, 50))).to(sink)
    run = execute(flow)
    assert times(sink) == list(range(50))
    assert (sink.opened, sink.closed) == (1, 1)
    assert run.sources["scores"].rows == run.sinks["testsink"].rows == 50
    assert not run.sources["scores"].up


def test_all_sinks_of_a_stream_get_its_batches_and_the_status_marks_recording_ones() -> None:
    flow, recorder, viewer = Flow("f"), TestSink(), TestSink()
    recorder.records = True
    touch = flow.source(TestSource(Scores, scores(0, 5)))
    touch.to(recorder)
    touch.to(viewer)
    assert [sink.records for sink in execute(flow).sinks.values()] == [True, False]
    assert times(recorder) == times(viewer) == list(range(5))


def test_garbage_collections_ignore_older_objects_during_a_run_only() -> None:
    class Frozen(TestSink):
        def take(self, batch: Batch) -> bool:
            counts.append(gc.get_freeze_count())
            return super().take(batch)

    gc.unfreeze()  # the collected tests
    flow, counts, before = Flow("f"), list[int](), len(gc.get_objects())
    flow.source(TestSource(Scores, scores(0, 2))).to(Frozen())
    execute(flow)
    assert min(counts) > before / 2
    assert gc.get_freeze_count() == 0


def test_rows_are_counted_after_their_delivery() -> None:
    class Counting(TestSink):
        async def open(self, run: Run) -> None:
            await super().open(run)
            (self.status,) = run.sources.values()

        def take(self, batch: Batch) -> bool:
            counted.append(self.status.rows)
            return super().take(batch)

    flow, counted = Flow("f"), list[int]()
    flow.source(TestSource(Scores, scores(0, 3))).to(Counting())
    execute(flow)
    assert counted == [0, 1, 2]


def test_a_missing_extra_is_an_error_before_anything_starts(hide_packages: Callable[..., None]) -> None:
    flow, sink = Flow("f"), TestSink()
    flow.source(TestSource(Scores, scores(0, 5))).to(sink)
    sink.extra = "gripper"
    hide_packages("pymodbus")
    with pytest.raises(InputError, match=r"^testsink: needs pymodbus: in the clone, pip install -e"):
        execute(flow)
    assert sink.opened == 0


def test_a_run_ends_after_its_duration() -> None:
    flow, sink, source = Flow("f"), TestSink(), Endless()
    flow.source(source).to(sink)
    execute(flow, duration=s)
    assert 98 <= len(sink.written) <= 100
    assert source.closed
    assert sink.closed == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_flushes_and_commits(number: signal.Signals) -> None:
    flow, sink = Flow("f"), TestSink()
    stream = flow.source(Endless())
    (stream | Debounce(consecutive=2)).to(sink)

    async def main() -> None:
        runner = LiveRunner(flow, "test")
        asyncio.get_running_loop().call_later(0.5, os.kill, os.getpid(), number)
        await runner.execute()

    run_virtually(main())
    assert len(sink.rows(Slips)) == 1
    assert sink.closed == 1


def test_signals_that_are_left_to_others_end_no_run() -> None:
    flow, sink, heard = Flow("f"), TestSink(), list[int]()
    flow.source(Endless()).to(sink)

    async def main() -> None:
        loop = asyncio.get_running_loop()
        loop.add_signal_handler(signal.SIGTERM, heard.append, 1)
        loop.call_later(0.5, os.kill, os.getpid(), signal.SIGTERM)
        await LiveRunner(flow, "test", duration=s, signals=False).execute()
        loop.remove_signal_handler(signal.SIGTERM)

    run_virtually(main())
    assert heard == [1]
    assert len(sink.written) >= 98


def test_a_failing_source_is_started_again_and_its_gap_recorded(caplog: pytest.LogCaptureFixture) -> None:
    flow, sink = Flow("f"), TestSink()
    broken: list[Scores | Exception] = [
        *scores(0, 10),
        OSError("unplugged"),
        OSError("still"),
        *scores(50, 10),
    ]
    flow.source(TestSource(Scores, broken)).to(sink)
    with caplog.at_level(logging.WARNING):
        run = execute(flow)
    assert times(sink) == [*range(10), *range(50, 60)]
    [gap] = run.sources["scores"].gaps
    assert gap.reason == "unplugged"
    assert gap.start == 90 * ms
    assert gap.end > gap.start
    assert [record.message for record in caplog.records] == [
        "scores failed, retrying: unplugged",
        "scores works again",
    ]


def test_a_failing_source_does_not_stop_the_others() -> None:
    flow, sink = Flow("f"), TestSink()
    flow.source(TestSource(Scores, [OSError("gone")] * 1000), name="broken").to(TestSink())
    flow.source(TestSource(Scores, scores(0, 100))).to(sink)
    run = execute(flow, duration=10 * s)
    assert times(sink) == list(range(100))
    assert not run.sources["broken"].up


SINGLE: Any = np.ones(1, np.float32)
OTHER_TYPE: Any = Slips.empty()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            Scores(np.array([0]), SINGLE),
            "scores: yielded Scores.probability: is float32, must be an array of float64",
        ),
        (Scores(np.arange(2), np.ones(1)), r"yielded Scores.probability: has shape \(1,\), must be \(2\)"),
        (
            Scores(np.array([3, 4, 2]), np.ones(3)),
            "scores: yielded Scores.time: decreases at row 2, must be in order",
        ),
        (
            OTHER_TYPE,
            "scores: yielded Slips, but declares Scores",
        ),
        (ParameterError("Fingertip", "seed", -5, "at least 0"), "Fingertip: seed is -5, must be at least 0"),
    ],
    ids=["dtype", "shape", "order", "type", "parameter"],
)
def test_a_source_that_breaks_its_contract_ends_the_run_at_once(
    wrong: Scores | Exception, message: str
) -> None:
    flow, sink = Flow("f"), TestSink()
    flow.source(TestSource(Scores, [*scores(0, 3), wrong, *scores(4, 1)])).to(sink)
    with pytest.raises(SlipflowError, match=message):
        execute(flow)
    assert times(sink) == [0, 1, 2]
    assert sink.closed == 1
    assert re.search(message, sink.run.error)


class Pausing(Source[Scores]):
    """Scores every 10 ms, with a pause after the first `before`."""

    def __init__(self, before: int, pause: float, after: int = 0) -> None:
        self._before, self._pause, self._after = before, pause, after

    @property
    def kind(self) -> type[Scores]:
        return Scores

    async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
        for count in (self._before, self._after):
            for _ in range(count):
                await clock.sleep_until(clock.now() + 10 * ms)
                yield Scores(np.array([clock.now()]), np.array([0.9]))
            await asyncio.sleep(self._pause)


def test_a_source_that_falls_silent_is_stale_until_its_next_row(caplog: pytest.LogCaptureFixture) -> None:
    flow, seen = Flow("f"), list[tuple[bool, bool, str]]()
    flow.source(Pausing(100, 20.0, 100)).to(TestSink())

    async def main() -> Run:
        runner = LiveRunner(flow, "test", duration=22 * s)
        status = runner.run.sources["scores"]
        for after in (4.0, 8.0, 21.5):
            asyncio.get_running_loop().call_later(
                after, lambda: seen.append((status.up, status.stale, status.error))
            )
        return await runner.execute()

    with caplog.at_level(logging.WARNING):
        run = run_virtually(main())
    assert seen == [(True, False, ""), (False, True, "delivered no rows for 5 s"), (True, False, "")]
    [gap] = run.sources["scores"].gaps
    assert (gap.end - gap.start) // s == 20
    assert gap.reason == "delivered no rows for 5 s"
    assert [record.message.partition(":")[0] for record in caplog.records] == [
        "scores delivered no rows for 5 s",
        "scores works again",
    ]
    assert not Summary.of(run).lost


@pytest.mark.parametrize(("rows", "duration"), [(0, s), (0, 30 * s), (100, 30 * s)])
def test_a_source_that_is_silent_at_the_end_makes_the_run_fail(rows: int, duration: int) -> None:
    flow = Flow("f")
    flow.source(Pausing(rows, 100.0)).to(TestSink())
    run = execute(flow, duration=duration)
    assert run.sources["scores"].stale
    assert "delivered" in Summary.of(run).report()
    assert Summary.of(run).lost


def test_a_stalled_host_and_a_full_sink_make_no_source_stale() -> None:
    flow = Flow("f")
    busy = TestSink(capacity=1, before_write=lambda: asyncio.sleep(7))
    flow.source(Pausing(4, 0.0)).to(busy)

    async def main() -> Run:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        loop.call_later(0.035, loop.stall, 60)
        return await LiveRunner(flow, "test").execute()

    run = run_virtually(main())
    assert (run.sources["scores"].rows, run.sources["scores"].gaps) == (4, [])


def test_a_source_with_rare_rows_is_never_stale() -> None:
    flow, rare = Flow("f"), Pausing(0, 100.0)
    rare.stale_after = None
    flow.source(rare).to(TestSink())
    assert not Summary.of(execute(flow, duration=60 * s)).lost


def test_a_background_task_that_fails_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: LoopClock) -> int:
        raise ZeroDivisionError

    monkeypatch.setattr(LoopClock, "host_offset", property(broken))
    flow, sink = Flow("f"), TestSink()
    flow.source(Endless()).to(sink)
    with pytest.raises(ZeroDivisionError):
        execute(flow, duration=60 * s)
    assert sink.closed == 1


def test_a_run_with_a_given_clock_reads_no_other_clock_and_starts_no_thread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def forbidden(*_: object) -> None:
        raise AssertionError("host clock or thread")

    flow, failing = Flow("f"), TestSink(failures=[OSError("dead")] * 5)
    flow.source(TestSource(Scores, [*scores(0, 10), OSError("gone"), *scores(50, 10)])).to(failing)
    flow.source(Pausing(50, 10.0, 50), "pausing").to(TestSink(capacity=1, lossless=False))

    async def main() -> Run:
        clock = LoopClock(1_700_000_000 * s)
        for name in ("time_ns", "monotonic", "monotonic_ns", "perf_counter", "perf_counter_ns"):
            monkeypatch.setattr(time, name, forbidden)
        monkeypatch.setattr(Thread, "start", forbidden)
        return await LiveRunner(flow, "test", clock=clock, duration=60 * s).execute()

    run = run_virtually(main())
    assert run.start == 1_700_000_000 * s
    assert [len(source.gaps) for source in run.sources.values()] == [1, 2]


class Slow(Endless):
    """Source that needs 20 s before the run."""

    async def prepare(self) -> None:
        await asyncio.sleep(20)


def test_a_signal_before_the_run_ends_it_without_opening_a_sink() -> None:
    flow, sink = Flow("f"), TestSink()
    flow.source(Slow()).to(sink)

    async def main() -> Run:
        asyncio.get_running_loop().call_later(1, os.kill, os.getpid(), signal.SIGTERM)
        return await LiveRunner(flow, "test").execute()

    assert run_virtually(main()).error == "was stopped before it began"
    assert sink.opened == 0


def test_a_signal_that_follows_the_announcement_of_a_sink_ends_the_run_orderly() -> None:
    class Announced(TestSink):
        async def open(self, run: Run) -> None:
            await super().open(run)
            os.kill(os.getpid(), signal.SIGTERM)  # as soon as it is announced as ready
            await asyncio.sleep(1)

    flow, sink = Flow("f"), Announced()
    flow.source(Endless()).to(sink)
    assert not execute(flow).error
    assert sink.closed == 1


def test_a_second_signal_ends_a_run_whose_sink_cannot_be_opened() -> None:
    class Waiting(TestSink):
        async def open(self, run: Run) -> None:
            await asyncio.sleep(math.inf)

    flow, opened, waiting = Flow("f"), TestSink(), Waiting()
    scored = flow.source(Endless())
    scored.to(opened)
    scored.to(waiting)

    async def main() -> Run:
        for seconds in (1, 2):
            asyncio.get_running_loop().call_later(seconds, os.kill, os.getpid(), signal.SIGTERM)
        async with asyncio.timeout(10):
            return await LiveRunner(flow, "test").execute()

    assert run_virtually(main()).error == "was stopped before it began"
    assert (opened.closed, waiting.opened) == (1, 0)


@dataclass
class Numbered(Join[Scores, Scores, Scores]):
    """Numbers what comes, by its time."""

    _next: int = field(default=0, init=False, repr=False)

    def process(self, left: Scores, right: Scores) -> Scores:
        self._next += 1
        return Scores(np.array([(self._next - 1) * 10 * ms]), (left if len(left) else right).probability)


class Following(Source[Scores]):
    """Source of one score on request."""

    def __init__(self, go: asyncio.Event) -> None:
        self._go = go

    @property
    def kind(self) -> type[Scores]:
        return Scores

    async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
        await self._go.wait()
        yield Scores(np.array([0]), np.array([0.9]))


def test_rows_of_another_source_do_not_overtake_when_a_full_sink_has_room() -> None:
    flow, go = Flow("f"), asyncio.Event()

    async def hold() -> None:
        await asyncio.sleep(1)
        go.set()  # the other source has its turn before the one that waits for room

    slow = TestSink(capacity=1, before_write=hold)
    one = flow.source(TestSource(Scores, scores(0, 1) * 3))  # one is written, one queued, one waits
    (one & flow.source(Following(go), name="other") | Numbered()).to(slow)
    execute(flow)
    assert times(slow) == [0, 1, 2, 3]


def test_a_step_of_the_hosts_clock_is_noted_and_changes_no_stamp(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    flow, sink, steps = Flow("f"), TestSink(), [0]
    real = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: real() + steps[0])
    flow.source(Endless()).to(sink)

    async def main() -> Run:
        runner = LiveRunner(flow, "test", duration=20 * s)
        loop = asyncio.get_running_loop()
        loop.call_later(5.5, steps.__setitem__, 0, -3600 * s)
        loop.call_later(12.5, steps.__setitem__, 0, -3600 * s + 50 * ms)
        return await runner.execute()

    with caplog.at_level(logging.WARNING):
        run = run_virtually(main())
    stamps = sink.rows(Scores).time
    assert set(np.diff(stamps).tolist()) == {10 * ms}
    assert [(step.time - run.start) // s for step in run.clock_steps] == [6, 13]
    assert [round(step.offset / ms) for step in run.clock_steps] == [-3_600_000, -3_599_950]
    assert [record.message for record in caplog.records] == [
        "the host's clock stepped by -3600.000 s; time stamps are not affected",
        "the host's clock stepped by +0.050 s; time stamps are not affected",
    ]


def test_a_failing_operator_ends_the_run_after_earlier_output_is_committed() -> None:
    class Broken(Debounce):
        def process(self, batch: Scores) -> Slips:
            if batch.time[0] >= 500 * ms:
                raise ZeroDivisionError
            return super().process(batch)

    flow, raw = Flow("f"), TestSink()
    stream = flow.source(TestSource(Scores, scores(0, 100)))
    stream.to(raw)
    (stream | Broken()).to(TestSink())
    with pytest.raises(OperatorError, match="flow 'f': Broken: ZeroDivisionError") as raised:
        execute(flow)
    assert isinstance(raised.value.__cause__, ZeroDivisionError)
    assert times(raw) == list(range(50))
    assert raw.closed == 1
    assert raw.run.error == str(raised.value)


@pytest.mark.parametrize("error", [KeyError("force"), ZeroDivisionError("division by zero")])
def test_a_mistake_in_a_source_ends_the_run_with_its_line(error: Exception) -> None:
    class Wrong(Endless):
        async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
            async for batch in super().batches(clock):
                yield batch
                raise error

    flow, sink = Flow("f"), TestSink()
    flow.source(Wrong()).to(sink)
    reason = rf"flow 'f': scores: {type(error).__name__}: .* \(test_live_runner\.py:\d+\)"
    with pytest.raises(OperatorError, match=reason):
        execute(flow)
    assert (len(sink.written), sink.closed) == (1, 1)


async def await_a_cancelled_task() -> None:
    task = asyncio.create_task(asyncio.sleep(1))
    task.cancel()
    await task


def test_a_source_that_awaits_a_cancelled_task_has_failed_and_is_retried() -> None:
    class Cancelled(TestSource[Scores]):
        async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
            async for batch in super().batches(clock):
                yield batch
                await await_a_cancelled_task()

    flow, sink = Flow("f"), TestSink()
    flow.source(Cancelled(Scores, scores(0, 3))).to(sink)
    status = execute(flow).sources["scores"]
    assert times(sink) == [0, 1, 2]
    assert (status.failures, status.error) == (3, "RuntimeError: a task that it awaited was cancelled")


def test_a_sink_that_awaits_a_cancelled_task_is_retried() -> None:
    class Cancelled(TestSink):
        failed = False

        async def write(self, batch: Batch) -> None:
            if not self.failed:
                self.failed = True
                await await_a_cancelled_task()
            await super().write(batch)

        def take(self, batch: Batch) -> bool:
            return self.failed and super().take(batch)

    flow, sink = Flow("f"), Cancelled()
    flow.source(TestSource(Scores, scores(0, 10))).to(sink)
    run = execute(flow)
    assert times(sink) == list(range(10))
    assert (run.sinks["cancelled"].failures, run.sinks["cancelled"].dropped) == (1, 0)


def test_an_error_of_a_devices_library_is_retried() -> None:
    class LibraryError(Exception):
        """Not one of Python's."""

    flow, sink = Flow("f"), TestSink()
    failures = LibraryError("no answer"), RuntimeError("not connected"), EOFError()
    flow.source(TestSource(Scores, [*scores(0, 1), *failures, *scores(1, 1)])).to(sink)
    assert execute(flow).sources["scores"].failures == 3
    assert len(sink.written) == 2


def test_a_sink_that_cannot_be_opened_ends_the_run_before_it_starts() -> None:
    class Closed(TestSink):
        async def open(self, run: Run) -> None:
            raise EndpointError("mqtt://nowhere", "no such host")

    class ClosesWithError(TestSink):
        async def close(self) -> None:
            raise OSError("disk full")

    flow, first = Flow("f"), TestSink()
    stream = flow.source(TestSource(Scores, scores(0, 10)))
    stream.to(ClosesWithError())
    stream.to(first)
    stream.to(Closed())
    with pytest.raises(EndpointError, match="mqtt://nowhere: no such host"):
        execute(flow)
    assert (first.opened, first.closed, first.written) == (1, 1, [])
    assert first.run.error == "mqtt://nowhere: no such host"


def test_late_rows_are_counted_and_reach_the_recorder_as_received() -> None:
    flow, raw, felt = Flow("f"), TestSink(), TestSink()
    stream = flow.source(TestSource(Scores, [*scores(0, 3), *scores(1, 1), *scores(3, 2)]))
    stream.to(raw)
    (stream | Debounce()).to(felt)
    run = execute(flow)
    assert times(raw) == [0, 1, 2, 1, 3, 4]
    assert run.sources["scores"].late == 1
    assert len(felt.rows(Slips)) == 1


def test_a_source_that_never_waits_leaves_the_others_their_turn() -> None:
    flow, sink = Flow("f"), TestSink(lossless=False, capacity=64)
    greedy = TestSource(Scores, scores(0, 1) * 1000)
    flow.source(greedy).to(sink)
    run = execute(flow)
    assert run.sinks["testsink"].dropped == 0
    assert len(sink.written) == 1000


class Recorded(Endless):
    """The same, from a recording."""

    @property
    def recording(self) -> str:
        return "stroke-9"


@pytest.mark.parametrize("source", [Endless, Recorded])
def test_one_recorded_source_makes_a_run_a_replay(source: type[Endless]) -> None:
    flow, sink = Flow("f"), TestSink()
    flow.source(Endless()).to(sink)
    flow.source(source()).to(TestSink())
    run = execute(flow, duration=s)
    assert run is sink.run
    assert (run.live, run.recording) == (True, "stroke-9" if source is Recorded else None)


@pytest.mark.parametrize(("source", "error"), [(Recorded, "was interrupted"), (Endless, "")])
def test_a_recording_that_was_stopped_is_not_complete(source: type[Endless], error: str) -> None:
    flow = Flow("f")
    flow.source(source()).to(TestSink())

    async def main() -> Run:
        runner = LiveRunner(flow, "test")
        asyncio.get_running_loop().call_later(1, runner.stop)
        return await runner.execute()

    assert run_virtually(main()).error == error


def test_the_preparation_of_a_source_precedes_the_run() -> None:
    flow, sink = Flow("f"), TestSink()
    flow.source(Slow()).to(sink)
    run = execute(flow, duration=s)
    assert 98 <= len(sink.written) <= 100
    assert run.clock.now() - run.start == s


def test_batches_read_before_the_end_of_the_run_are_delivered() -> None:
    flow = Flow("f")

    async def slowly() -> None:
        await asyncio.sleep(0.05)  # five times slower than the source, which waits most of the time

    slow, other = TestSink(capacity=2, before_write=slowly), TestSink(capacity=2, before_write=slowly)
    stream = flow.source(TestSource(Scores, scores(0, 1000)))
    stream.to(slow)
    stream.to(other)
    run = execute(flow, duration=s)
    assert times(slow) == times(other) == list(range(run.sources["scores"].rows))
    assert 10 < run.sources["scores"].rows < 100


def test_an_operator_that_fails_while_the_run_drains_is_not_forgotten() -> None:
    class Broken(Debounce):
        def process(self, batch: Scores) -> Slips:
            raise ZeroDivisionError

    async def slowly() -> None:
        await asyncio.sleep(3)

    flow = Flow("f")
    flow.source(TestSource(Scores, scores(0, 500)), "busy").to(TestSink(capacity=1, before_write=slowly))
    late = TestSource(Scores, [*scores(0, 1), *scores(400, 1)])
    (flow.source(late, "late") | Broken()).to(TestSink())
    with pytest.raises(OperatorError, match="Broken"):
        execute(flow, duration=5 * s)


def test_the_gap_of_a_source_that_never_comes_back_is_recorded() -> None:
    flow, sink = Flow("f"), TestSink()
    broken: list[Scores | Exception] = [*scores(0, 10), *[OSError("gone")] * 1000]
    flow.source(TestSource(Scores, broken)).to(sink)
    run = execute(flow, duration=10 * s)
    [gap] = run.sources["scores"].gaps
    assert (gap.start, gap.reason) == (90 * ms, "gone")
    assert gap.end == pytest.approx(run.start + 10 * s)
    assert run.sources["scores"].error == "gone"


def test_fingertips_of_one_source_are_not_late_against_each_other() -> None:
    flow, sink = Flow("f"), TestSink()
    batches = [Scores(np.arange(3), np.ones(3), finger=finger) for finger in (0, 1)]
    flow.source(TestSource(Scores, batches, fingers=(0, 1))).to(sink)
    assert execute(flow).sources["scores"].late == 0


def test_a_failed_source_lets_go_of_its_device_before_it_is_opened_again() -> None:
    class Device(Endless):
        open = 0

        async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
            assert not Device.open
            Device.open += 1
            try:
                if Device.open:
                    raise OSError("unplugged")
                yield Scores(np.array([0]), np.array([0.9]))
            finally:
                Device.open -= 1

    flow = Flow("f")
    flow.source(Device()).to(TestSink())
    run = execute(flow, duration=s)
    assert run.sources["scores"].failures > 1
    assert Device.open == 0


@pytest.mark.parametrize("stall", [0.2, 1.0])
def test_rows_of_one_time_are_joined_after_a_stall_of_the_host(stall: float) -> None:
    flow, sink = Flow("f"), TestSink()
    cells, flags = np.full((1, 6), 500, np.int16), np.ones((1, 6), np.bool_)
    six = np.zeros((1, 6))
    felt = [Touch(np.array([k * 10 * ms]), cells, cells, flags, finger=0) for k in range(200)]
    moved = [Motion(np.array([k * 8 * ms]), np.array([k]), six, six) for k in range(250)]
    touch = flow.source(TestSource(Touch, felt, fingers=(0,)))
    motion = flow.source(TestSource(Motion, moved))
    ((touch | Zero(500)) & motion | Align(within=20 * ms)).to(sink)

    async def main() -> None:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        loop.call_later(0.5, loop.stall, stall)
        await LiveRunner(flow, "test").execute()

    run_virtually(main())
    samples = sink.rows(Sample, 0)
    assert len(samples) == 200
    assert samples.matched.all()


@pytest.mark.parametrize("exits", ["source", "operator"])
def test_a_source_or_operator_that_calls_sys_exit_ends_the_run_with_its_error(exits: str) -> None:
    class Leaving(Endless):
        async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
            async for batch in super().batches(clock):
                yield batch
                if exits == "source":
                    raise SystemExit

    class Judge(Debounce):
        def process(self, batch: Scores) -> Slips:
            if exits == "operator":
                raise SystemExit(3)
            return super().process(batch)

    flow, sink = Flow("f"), TestSink()
    (flow.source(Leaving()) | Judge()).to(sink)
    part = {"source": "scores: calls sys.exit()", "operator": "Judge: calls sys.exit"}[exits]
    with pytest.raises(OperatorError, match=re.escape(f"flow 'f': {part}")):
        execute(flow)
    assert sink.closed == 1


def test_a_queue_whose_task_fails_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    async def fail(queue: SinkQueue) -> None:
        del queue
        await asyncio.sleep(1.0)
        raise KeyError("planted")

    monkeypatch.setattr(SinkQueue, "_run", fail)
    flow = Flow("f")
    flow.source(Endless()).to(TestSink())
    with pytest.raises(KeyError, match="planted"):
        execute(flow)
