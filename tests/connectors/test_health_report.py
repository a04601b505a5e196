from typing import Any

import pytest

from connectors.health_report import HealthReports
from operators.batch import ms, s
from operators.ports import ClockStep, Gap, Json, Run, SinkStatus, SourceStatus


class Present:
    """Clock that shows a set time."""

    time = 100 * s

    def now(self) -> int:
        return self.time

    async def sleep_until(self, time: int) -> None:
        raise NotImplementedError


@pytest.fixture
def clock() -> Present:
    return Present()


@pytest.fixture
def run(clock: Present) -> Run:
    return Run("run1", "live", clock, 90 * s)


def touch_of(reports: HealthReports) -> dict[str, Json]:
    sources = reports.next()["sources"]
    assert isinstance(sources, dict)
    touch = sources["touch"]
    assert isinstance(touch, dict)
    return touch


def test_a_rate_is_since_the_previous_report(run: Run, clock: Present) -> None:
    run.sources["touch"] = touch = SourceStatus(rows=1000, up=True)
    reports = HealthReports(run)
    reports.next()
    clock.time += 2 * s
    touch.rows += 100
    assert touch_of(reports)["rate_hz"] == 50


def test_a_rate_excludes_the_time_before_the_first_row(run: Run, clock: Present) -> None:
    run.sources["touch"] = touch = SourceStatus(up=True)
    reports = HealthReports(run)
    assert touch_of(reports)["rate_hz"] is None
    clock.time += s
    touch.rows += 83  # it began 0.17 s late
    assert touch_of(reports)["rate_hz"] is None
    clock.time += s
    touch.rows += 100
    assert touch_of(reports)["rate_hz"] == 100
    clock.time += s
    assert touch_of(reports)["rate_hz"] == 0  # it gives nothing any more


def test_a_rate_over_zero_time_is_unknown(run: Run) -> None:
    run.sources["touch"] = SourceStatus(rows=1000, up=True)
    reports = HealthReports(run)
    reports.next()
    assert touch_of(reports)["rate_hz"] is None


def test_a_source_is_up_stale_or_down(run: Run) -> None:
    run.sources["touch"] = touch = SourceStatus(rows=10, up=True)
    reports = HealthReports(run)
    assert touch_of(reports)["state"] == "up"
    assert touch_of(reports)["state"] == "up"  # between two rows of a slow source
    touch.up, touch.stale = False, True
    assert touch_of(reports)["state"] == "stale"
    touch.stale = False
    assert touch_of(reports)["state"] == "down"


def test_a_report_has_lag_gaps_and_dropped_rows(run: Run) -> None:
    gap = Gap(91 * s, 92 * s, "unplugged")
    run.sources["touch"] = SourceStatus(rows=10, late=2, newest=100 * s - 5 * ms, up=True, gaps=[gap])
    run.sources["motion"] = SourceStatus()
    run.sinks["dataset"] = SinkStatus(rows=9, queued=1, dropped=3, failures=2, error="disk full")
    run.sinks["mqtt"] = SinkStatus()
    report: Any = HealthReports(run).next()
    assert report["time_ns"] == 100 * s
    touch, motion = report["sources"]["touch"], report["sources"]["motion"]
    assert (touch["rows"], touch["late"], touch["gaps"], touch["lag_ms"]) == (10, 2, 1, 5)
    assert motion["lag_ms"] is None
    assert report["sinks"]["dataset"] == {
        "rows": 9,
        "queued": 1,
        "dropped": 3,
        "failures": 2,
        "error": "disk full",
    }
    assert report["sinks"]["mqtt"]["error"] is None


def test_a_report_has_the_newest_steps_of_the_host_clock(run: Run) -> None:
    run.clock_steps += [ClockStep(k * s, k * ms) for k in range(20)]
    steps = HealthReports(run).next()["clock_steps"]
    assert steps == [{"time": k * s, "offset": k * ms} for k in range(10, 20)]
