import asyncio
from typing import Any

from connectors.mqtt.mqtt_sink import HealthReports
from operators.batch import ms, s
from operators.ports import ClockStep, Gap, Run, SinkStatus, SourceStatus


def test_a_rate_is_since_the_previous_report_that_has_rows(run: Run) -> None:
    run.sources["touch"] = touch = SourceStatus(up=True)
    reports, rates = HealthReports(run), list[Any]()
    for rows, seconds in (0, 0), (83, 1), (100, 1), (0, 1), (50, 2), (5, 0):  # the first 83 began late
        touch.rows += rows
        asyncio.run(run.clock.sleep_until(run.clock.now() + seconds * s))
        report: Any = reports.next()
        rates.append(report["sources"]["touch"]["rate_hz"])
    assert rates == [None, None, 100, 0, 25, None]


def test_a_report_has_lag_gaps_dropped_rows_and_the_newest_clock_steps(run: Run) -> None:
    gap = Gap(91 * s, 92 * s, "unplugged")
    run.sources["touch"] = SourceStatus(rows=10, late=2, newest=100 * s - 5 * ms, up=True, gaps=[gap])
    run.sources["motion"], run.sources["force"] = SourceStatus(), SourceStatus(stale=True)
    counters: dict[str, Any] = {"rows": 9, "queued": 1, "dropped": 3, "failures": 2}
    run.sinks["dataset"] = SinkStatus(**counters, error="disk full")
    run.sinks["mqtt"] = SinkStatus()
    run.clock_steps += [ClockStep(k * s, k * ms) for k in range(20)]
    report: Any = HealthReports(run).next()
    assert report["time_ns"] == 100 * s
    touch, motion, force = (report["sources"][name] for name in ("touch", "motion", "force"))
    assert (touch["rows"], touch["late"], touch["gaps"], touch["lag_ms"]) == (10, 2, 1, 5)
    assert (touch["state"], motion["state"], force["state"]) == ("up", "down", "stale")
    assert motion["lag_ms"] is None
    assert report["sinks"]["dataset"] == {**counters, "error": "disk full"}
    assert report["sinks"]["mqtt"]["error"] is None
    assert report["clock_steps"] == [{"time": k * s, "offset": k * ms} for k in range(10, 20)]
