import asyncio
import logging
import math
import re
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource, VirtualLoop
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
    Run,
    Sample,
    Scores,
    SlipflowError,
    Slips,
    Touch,
    Zero,
    ms,
    s,
)
from tests.flows.run.live import Endless, FaultySink, execute, flow_of, scores, times
from tests.waiting import PATIENCE


def test_a_missing_extra_is_an_error_before_anything_starts(hide_packages: Callable[..., None]) -> None:
    sink = TestSink()
    sink.extra = "gripper"
    hide_packages("pymodbus")
    with pytest.raises(InputError, match=r"^testsink: needs pymodbus: in the clone, pip install -e"):
        execute(flow_of(TestSource(Scores, scores(0, 5)), sink))
    assert sink.opened == 0


@pytest.mark.parametrize(("recording", "error"), [("stroke-9", "was interrupted"), (None, "")])
def test_a_stop_flushes_and_commits_and_leaves_a_replay_incomplete(recording: str | None, error: str) -> None:
    sink, source = TestSink(), Endless()
    source.recorded = recording
    run = execute(flow_of(source, sink, through=[Debounce(consecutive=2)]), stops=(0.5,))
    assert (len(sink.rows(Slips)), sink.closed) == (1, 1)
    assert (run.live, run.recording, run.error) == (True, recording, error)


@pytest.mark.parametrize("where", ["check", "queue"])
def test_a_background_task_that_fails_ends_the_run(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: LoopClock) -> int:
        raise ZeroDivisionError

    async def fail(_: SinkQueue) -> None:
        await asyncio.sleep(1.0)
        raise ZeroDivisionError

    if where == "check":
        monkeypatch.setattr(LoopClock, "host_offset", property(broken))
    else:
        monkeypatch.setattr(SinkQueue, "_run", fail)
    with pytest.raises(ZeroDivisionError):
        execute(flow_of(Endless(), TestSink()), duration=60 * s)


class Waiting(TestSink):
    """Sink that never opens."""

    async def open(self, run: Run) -> None:
        await asyncio.sleep(math.inf)


def test_a_second_stop_ends_the_opening_of_sinks() -> None:
    first = TestSink()
    assert execute(flow_of(Endless(), first, Waiting()), stops=(1, 2)).error == "was stopped before it began"
    assert (first.opened, first.closed) == (1, 1)


@dataclass
class Numbered(Join[Scores, Scores, Scores]):
    """Numbers what comes, by its time."""

    _next: int = field(default=0, init=False, repr=False)

    def process(self, left: Scores, right: Scores) -> Scores:
        self._next += 1
        return Scores(np.array([(self._next - 1) * 10 * ms]), (left if len(left) else right).probability)


class Following(Endless):
    """Source of one score on request."""

    def __init__(self, go: asyncio.Event) -> None:
        self._go = go

    async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
        await self._go.wait()
        yield Scores(np.array([0]), np.array([0.9]))


def test_rows_of_another_source_do_not_overtake_when_a_full_sink_has_room() -> None:
    flow, go = Flow("f"), asyncio.Event()

    async def hold() -> None:
        await asyncio.sleep(1)
        go.set()  # the other source has its turn before the one that waits for room

    slow = FaultySink(capacity=1, before_write=hold)
    one = flow.source(TestSource(Scores, scores(0, 1) * 3))  # one is written, one queued, one waits
    (one & flow.source(Following(go), name="other") | Numbered()).to(slow)
    execute(flow)
    assert times(slow) == [0, 1, 2, 3]


def test_a_step_of_the_hosts_clock_is_noted_and_changes_no_stamp(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    sink, steps, real = TestSink(), [0], time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: real() + steps[0])
    at: dict[float, Callable[[LiveRunner, VirtualLoop], object]] = {
        5.5: lambda *_: steps.append(steps.pop() - 3600 * s),
        12.5: lambda *_: steps.append(steps.pop() + 50 * ms),
    }
    with caplog.at_level(logging.WARNING):
        run = execute(flow_of(Endless(), sink), duration=20 * s, at=at)
    assert set(np.diff(sink.rows(Scores).time).tolist()) == {10 * ms}
    assert [(step.time - run.start) // s for step in run.clock_steps] == [6, 13]
    assert [round(step.offset / ms) for step in run.clock_steps] == [-3_600_000, -3_599_950]
    assert caplog.messages == [
        f"the host's clock stepped by {step} s; time stamps are not affected"
        for step in ("-3600.000", "+0.050")
    ]


class Broken(Debounce):
    """Fails half a second after the start."""

    def process(self, batch: Scores) -> Slips:
        if batch.time[0] >= 500 * ms:
            raise ZeroDivisionError
        return super().process(batch)


def test_a_failing_operator_ends_the_run_after_earlier_output_is_committed() -> None:
    flow, raw = Flow("f"), TestSink()
    stream = flow.source(TestSource(Scores, scores(0, 100)))
    stream.to(raw)
    (stream | Broken()).to(TestSink())
    with pytest.raises(OperatorError, match="flow 'f': Broken: ZeroDivisionError") as raised:
        execute(flow)
    assert isinstance(raised.value.__cause__, ZeroDivisionError)
    assert times(raw) == list(range(50))
    assert (raw.closed, raw.run.error) == (1, str(raised.value))


def test_an_operator_that_fails_while_the_run_drains_is_not_forgotten() -> None:
    busy = FaultySink(capacity=1, before_write=lambda: asyncio.sleep(3))
    flow = flow_of(TestSource(Scores, scores(0, 500)), busy)
    late = TestSource(Scores, [*scores(0, 1), *scores(400, 1)])
    (flow.source(late, "late") | Broken()).to(TestSink())
    with pytest.raises(OperatorError, match="Broken"):
        execute(flow, duration=5 * s)


async def await_a_cancelled_task() -> None:
    task = asyncio.create_task(asyncio.sleep(1))
    task.cancel()
    await task


def test_a_source_or_sink_that_awaits_a_cancelled_task_has_failed_and_is_retried() -> None:
    class Cancelled(TestSource[Scores]):
        async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
            async for batch in super().batches(clock):
                yield batch
                await await_a_cancelled_task()

    failures = [await_a_cancelled_task] * 2
    sink = FaultySink(before_write=lambda: failures.pop()() if failures else asyncio.sleep(0))
    run = execute(flow_of(Cancelled(Scores, scores(0, 3)), sink))
    assert times(sink) == [0, 1, 2]
    status = run.sources["scores"]
    assert (status.failures, status.error) == (3, "RuntimeError: a task that it awaited was cancelled")
    assert (run.sinks["faultysink"].failures, run.sinks["faultysink"].dropped) == (2, 0)


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (EndpointError("mqtt://nowhere", "no such host"), "mqtt://nowhere: no such host"),
        (OSError("no such host"), r"flow 'f': closed: no such host \(test_live_runner.py:\d+\)"),
        (ValueError("host"), r"flow 'f': closed: ValueError: host \(test_live_runner.py:\d+\)"),
    ],
)
def test_a_sink_that_cannot_be_opened_ends_the_run_before_it_starts(error: Exception, text: str) -> None:
    class Closed(TestSink):
        async def open(self, run: Run) -> None:
            raise error

    class ClosesWithError(TestSink):
        async def close(self) -> None:
            raise OSError("disk full")

    recorder, first = TestSink(), TestSink()
    recorder.records = True
    with pytest.raises(SlipflowError, match=f"^{text}$"):
        execute(flow_of(TestSource(Scores, scores(0, 10)), recorder, ClosesWithError(), first, Closed()))
    assert recorder.opened == 0  # else an empty session would stay
    assert (first.opened, first.closed, first.written) == (1, 1, list[Batch]())
    assert re.match(f"{text}$", first.run.error)


def test_late_rows_are_counted_and_reach_the_recorder_as_received() -> None:
    flow, raw, felt = Flow("f"), TestSink(), TestSink()
    stream = flow.source(TestSource(Scores, [*scores(0, 3), *scores(1, 1), *scores(3, 2)]))
    stream.to(raw)
    (stream | Debounce()).to(felt)
    run = execute(flow)
    assert times(raw) == [0, 1, 2, 1, 3, 4]
    assert run.sources["scores"].late == 1
    assert len(felt.rows(Slips)) == 1


@pytest.mark.parametrize("late", [10, 2])
def test_a_run_fails_if_one_wrong_stamp_makes_most_rows_late(late: int) -> None:
    run = execute(flow_of(TestSource(Scores, [*scores(0, 4), *scores(500, 1), *scores(4, late)]), TestSink()))
    summary = Summary.of(run)
    text = f"scores: {late} of {5 + late} rows were late, so operators ignored them"
    assert summary.error == (text if late == 10 else "")


def test_a_source_that_never_waits_leaves_the_others_their_turn() -> None:
    sink = FaultySink(lossless=False, capacity=64)
    run = execute(flow_of(TestSource(Scores, scores(0, 1) * 1000), sink))
    assert (run.sinks["faultysink"].dropped, len(sink.written)) == (0, 1000)


@pytest.mark.parametrize("stall", [0.2, 1.0])
def test_rows_of_one_time_are_joined_after_a_stall_of_the_host(stall: float) -> None:
    flow, sink = Flow("f"), TestSink()
    felt = [Touch.rows([k * 10 * ms], [[500] * 6], 500, True, finger=0) for k in range(200)]
    moved = [Motion.rows([k * 8 * ms], k, 0, 0) for k in range(250)]
    touch = flow.source(TestSource(Touch, felt, fingers=(0,)))
    motion = flow.source(TestSource(Motion, moved))
    ((touch | Zero(500)) & motion | Align(within=20 * ms)).to(sink)
    execute(flow, at={0.5: lambda _, loop: loop.stall(stall)})
    samples = sink.rows(Sample, 0)
    assert len(samples) == 200
    assert samples.matched.all()


class Flooded(Endless):
    """Source that never waits and yields batches without rows, as of a device that sends other messages."""

    async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
        while True:
            yield Scores.empty()


class Stubborn(Endless):
    """Source that catches its first cancellation."""

    async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
        try:
            async for batch in super().batches(clock):
                yield batch
        except asyncio.CancelledError:
            await asyncio.sleep(3600)


def test_a_run_ends_on_time_although_a_source_floods_it_without_rows() -> None:
    async def main() -> Run:
        flow = flow_of(Endless(), TestSink())
        flow.source(Flooded(), "flooded").to(TestSink())
        return await asyncio.wait_for(LiveRunner(flow, "test", duration=s // 5).execute(), PATIENCE)

    run = asyncio.run(main())
    assert 0 < run.sources["scores"].rows <= 20
    assert run.sources["flooded"].rows == 0


def test_a_source_that_does_not_end_when_it_is_cancelled_keeps_no_sink_open() -> None:
    sink = TestSink()
    run = execute(flow_of(Stubborn(), sink), duration=s)
    assert run.clock.now() - run.start == 6 * s
    assert (sink.closed, len(sink.written)) == (1, run.sources["scores"].rows)
