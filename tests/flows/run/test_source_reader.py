"""Sources of a live run: they fail, are silent, or break their contract."""

import asyncio
import logging
import re
from collections.abc import AsyncIterator, Callable
from typing import Any, Final

import numpy as np
import pytest

from flows.graph.testing import TestSink, TestSource
from flows.run.failures import reason_of
from flows.run.live_runner import LiveRunner
from flows.run.run_summary import Summary
from operators import Clock, ParameterError, Scores, SlipflowError, Slips, ms, s
from operators.ports import Description
from tests.flows.run.live import Endless, FaultySink, execute, flow_of, scores, times

NOW: Final = 1_700_000_000 * s


class LibraryError(Exception):
    """Not one of Python's."""


def test_a_failing_source_is_started_again_and_its_gap_recorded(caplog: pytest.LogCaptureFixture) -> None:
    failures = OSError("unplugged"), LibraryError("no answer"), RuntimeError("not connected"), EOFError()
    sink = TestSink()
    with caplog.at_level(logging.INFO, "slipflow"):
        run = execute(flow_of(TestSource(Scores, [*scores(0, 10), *failures, *scores(500, 10)]), sink))
    assert times(sink) == [*range(10), *range(500, 510)]
    assert run.sources["scores"].failures == 4
    [gap] = run.sources["scores"].gaps
    assert (gap.reason, gap.start, gap.end > gap.start) == ("unplugged", 90 * ms, True)
    assert caplog.messages == ["scores failed, retrying: unplugged", "scores works again"]


def test_a_source_that_never_works_again_stops_no_other_and_its_gap_is_recorded() -> None:
    sink = TestSink()
    flow = flow_of(TestSource(Scores, scores(0, 100)), sink)
    broken = TestSource(Scores, [*scores(0, 10), *[OSError("gone")] * 1000])
    flow.source(broken, name="broken").to(TestSink())
    run = execute(flow, duration=10 * s)
    assert times(sink) == list(range(100))
    status = run.sources["broken"]
    assert (status.up, status.error) == (False, "gone")
    [gap] = status.gaps
    assert (gap.start, gap.reason) == (90 * ms, "gone")
    assert gap.end == pytest.approx(run.start + 10 * s)


OTHER_TYPE: Any = Slips.empty()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (Scores(np.arange(2), np.ones(1)), r"yielded Scores.probability: has shape \(1,\), must be \(2\)"),
        (Scores(np.array([3, 4, 2]), np.ones(3)), "scores: yielded Scores.time: decreases at row 2, must"),
        (OTHER_TYPE, "scores: yielded Slips, but declares Scores"),
        (ParameterError("Fingertip", "seed", -5, "at least 0"), "Fingertip: seed is -5, must be at least 0"),
        (KeyError("force"), r"flow 'f': scores: KeyError: 'force' \(testing\.py:\d+\)"),
    ],
    ids=["shape", "order", "type", "parameter", "mistake"],
)
def test_a_source_that_breaks_its_contract_ends_the_run(wrong: Scores | Exception, message: str) -> None:
    sink = TestSink()
    with pytest.raises(SlipflowError, match=message):
        execute(flow_of(TestSource(Scores, [*scores(0, 3), wrong, *scores(4, 1)]), sink))
    assert times(sink) == [0, 1, 2]
    assert sink.closed == 1
    assert re.search(message, sink.run.error)


class Stamping(Endless):
    """Scores every 10 ms with times of another clock."""

    def __init__(self, stamp: Callable[[int], int], *, in_run_time: bool) -> None:
        self._stamp, self.in_run_time = stamp, in_run_time

    async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
        async for batch in super().batches(clock):
            yield Scores(np.array([self._stamp(batch.time.item())]), batch.probability)


@pytest.mark.parametrize(
    ("stamp", "distance"),
    [
        (lambda now: now // s, "1,699,999,999 s ago"),
        (lambda now: now - NOW, "1,700,000,000 s ago"),
        (lambda now: now + 3600 * s, "3,600 s in the future"),
        (lambda now: now - 1800 * s, ""),
        (lambda now: now + 30 * s, ""),
    ],
    ids=["seconds", "counter", "hour ahead", "old rows", "clock of a device"],
)
@pytest.mark.parametrize("duration", [s // 2, 7 * s])
def test_a_source_that_stamps_its_rows_in_another_clock_is_named_once_unless_they_are_of_another_time(
    stamp: Callable[[int], int], distance: str, duration: int, caplog: pytest.LogCaptureFixture
) -> None:
    for own in (False, True):
        assert not caplog.messages
        execute(flow_of(Stamping(stamp, in_run_time=own), TestSink()), duration=duration, start=NOW)
    text = f"scores delivered rows of {distance}: time must be ns of the run's clock"
    assert caplog.messages == ([text] if distance else [])


@pytest.mark.parametrize(
    ("stamp", "late"),
    [
        (lambda now: now + 30 * s * (now == NOW + 2 * s), 1),
        (lambda now: now + 3600 * s * (now <= NOW + 10 * ms), 1),
        (lambda now: now + 90 * s + 30 * s * (now == NOW + 2 * s), 1),
        (lambda now: now + 30 * s * (now >= NOW + 2 * s), 0),
        (lambda now: now + 900 * ms * (now >= NOW + 2 * s), 0),
    ],
    ids=["one row", "the first row", "clock of another host", "the clock is set", "a small step"],
)
def test_a_row_of_the_future_is_dropped_unless_the_next_one_is_too(
    stamp: Callable[[int], int], late: int, caplog: pytest.LogCaptureFixture
) -> None:
    sink = TestSink()
    run = execute(flow_of(Stamping(stamp, in_run_time=True), sink), duration=10 * s, start=NOW)
    status = run.sources["scores"]
    time = sink.rows(Scores).time
    assert (status.late, len(time)) == (late, status.rows - late)
    assert status.rows >= 999
    assert (np.diff(time) > 0).all()
    assert sum("a row of" in text and "in the future" in text for text in caplog.messages) == late


def test_the_last_rows_of_a_source_are_delivered_even_if_they_are_of_the_future() -> None:
    source = TestSource(Scores, [Scores.rows([NOW, NOW + 9 * s], 0.9)])
    source.in_run_time, sink = True, TestSink()
    run = execute(flow_of(source, sink), start=NOW)
    assert (len(sink.rows(Scores)), run.sources["scores"].late) == (2, 0)


def test_a_source_whose_first_row_is_wrong_is_not_called_silent(caplog: pytest.LogCaptureFixture) -> None:
    wrong = Scores(np.array([0]), np.array([0.9]), finger=3)
    with pytest.raises(SlipflowError, match=r"source 'scores' yielded fingertip 3, but declares \(-1,\)"):
        execute(flow_of(TestSource(Scores, [wrong]), TestSink()))
    assert not caplog.messages


@pytest.mark.parametrize(
    ("path", "remedy"),
    [
        (None, "check the cable and the power"),
        ("/dev/ttyUSB0", "check the cable and the power"),
        ("/data/rows.csv", "the disk is failing: see the system log"),
    ],
)
def test_an_error_of_input_or_output_is_a_failing_disk_only_for_a_file(path: str | None, remedy: str) -> None:
    assert reason_of(OSError(5, "Input/output error", path)).endswith(f"Input/output error; {remedy}")


class Pausing(Endless):
    """Scores every 10 ms, with a pause after the first `before`."""

    def __init__(self, before: int, pause: float, after: int = 0) -> None:
        self._before, self._pause, self._after = before, pause, after

    async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
        for count in (self._before, self._after):
            for _ in range(count):
                await clock.sleep_until(clock.now() + 10 * ms)
                yield Scores(np.array([clock.now()]), np.array([0.9]))
            await asyncio.sleep(self._pause)


def two_of_the_future(now: int) -> int:
    return now + 30 * s * (NOW + 2 * s <= now < NOW + 2 * s + 20 * ms)


@pytest.mark.parametrize(
    ("source", "reason", "gap_end", "likely"),
    [
        (Pausing(300, 20.0, 200), "delivered no rows for 5 s", 23, ""),
        (
            Stamping(two_of_the_future, in_run_time=True),
            "delivered only late rows for 5 s",
            32,
            ": its clock was set back, or a row was of the future",
        ),
    ],
    ids=["silent", "late rows"],
)
def test_a_source_without_rows_to_use_is_stale_until_its_next_one(
    source: Endless, reason: str, gap_end: int, likely: str, caplog: pytest.LogCaptureFixture
) -> None:
    seen = list[tuple[bool, bool, str]]()

    def look(runner: LiveRunner, _: object) -> None:
        status = runner.run.sources["scores"]
        seen.append((status.up, status.stale, status.error))

    looks = dict.fromkeys((4.0, 10.0, gap_end + 1.0), look)
    with caplog.at_level(logging.INFO, "slipflow"):
        run = execute(flow_of(source, TestSink()), duration=(gap_end + 2) * s, start=NOW, at=looks)
    assert seen == [(True, False, ""), (False, True, reason), (True, False, "")]
    [gap] = run.sources["scores"].gaps
    assert (round((gap.start - NOW) / s), round((gap.end - NOW) / s), gap.reason) == (3, gap_end, reason)
    stale, again = caplog.messages
    assert stale.startswith(f"scores {reason}{likely}")
    assert again == "scores works again"
    assert reason not in Summary.of(run).error


@pytest.mark.parametrize(("rows", "duration"), [(0, s), (0, 30 * s), (100, 30 * s)])
@pytest.mark.parametrize("rare", [False, True])
def test_a_source_that_is_silent_at_the_end_makes_the_run_fail_unless_its_rows_are_rare(
    rows: int, duration: int, *, rare: bool
) -> None:
    source = Pausing(rows, 100.0)
    source.stale_after = None if rare else source.stale_after
    run = execute(flow_of(source, TestSink()), duration=duration)
    assert run.sources["scores"].stale is bool(Summary.of(run).error) is not rare
    assert ("delivered" in Summary.of(run).report()) is not rare


def test_rows_that_are_missing_in_a_short_pause_are_in_the_summary() -> None:
    class Regular(Pausing):
        def describe(self) -> Description:
            return {"rate_hz": 100}

    run = execute(flow_of(Regular(100, 1.5, 100), TestSink()), duration=4 * s)
    assert "scores: 200 rows in, 0 late, 150 missing, 0 gaps" in Summary.of(run).report()


def test_a_run_that_stood_still_is_named_and_a_full_sink_makes_no_source_stale(
    caplog: pytest.LogCaptureFixture,
) -> None:
    busy = FaultySink(capacity=1, before_write=lambda: asyncio.sleep(7))
    run = execute(flow_of(Pausing(4, 0.0), busy), at={0.035: lambda _, loop: loop.stall(60)})
    assert (run.sources["scores"].rows, run.sources["scores"].gaps) == (4, [])
    assert "the run stood still for 60" in caplog.text


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

    run = execute(flow_of(Device(), TestSink()), duration=s)
    assert run.sources["scores"].failures > 1
    assert Device.open == 0


@pytest.mark.parametrize("failure", [OSError(5, "Input/output error"), KeyError("handle")])
@pytest.mark.parametrize("slow", [False, True], ids=["cancelled", "while a sink is full"])
def test_a_source_that_fails_to_close_is_not_opened_again_and_costs_the_run_nothing(
    failure: Exception, caplog: pytest.LogCaptureFixture, *, slow: bool
) -> None:
    class Unplugged(Endless):
        opened = 0

        async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
            Unplugged.opened += 1
            try:
                async for batch in super().batches(clock):
                    yield batch
            finally:
                raise failure

    sink = FaultySink(capacity=1, before_write=lambda: asyncio.sleep(0.3)) if slow else TestSink()
    run = execute(flow_of(Unplugged(), sink), duration=s)
    assert Unplugged.opened == 1
    assert (sink.closed, len(sink.written)) == (1, run.sources["scores"].rows)
    assert not Summary.of(run).error
    [text] = caplog.messages
    assert text.startswith("scores failed to close: ")
