"""The text is read back by prometheus_client's own parser."""

import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families

from connectors.web.run_metrics import RunMetrics
from operators.batch import Clocks, Faults, Slips, ms, s
from operators.health import FaultKind
from operators.ports import ClockStep, Gap, Run, SinkStatus, SourceStatus
from tests.connectors.web.reading import scored

NOW = 100 * s


def read(metrics: RunMetrics) -> dict[str, float]:
    """Return each sample by its name and labels."""
    return {
        f"{sample.name}{sorted(sample.labels.items())}" if sample.labels else sample.name: sample.value
        for family in text_string_to_metric_families(metrics.text().decode())
        for sample in family.samples
    }


def key(name: str, **labels: str) -> str:
    return f"{name}{sorted(labels.items())}"


def slips(*times: int, state: int = 1, finger: int = 0) -> Slips:
    time = np.array(times)
    return Slips(time, np.full(len(time), state, np.int8), time, np.full(len(time), 0.9), finger=finger)


def test_sources_and_sinks_are_those_of_the_runner(run: Run) -> None:
    metrics, strange = RunMetrics(run), 'a "b"\n\\c'
    run.sources["touch"] = SourceStatus(rows=500, late=3, newest=NOW - 30 * ms, up=True)
    run.sources[strange] = SourceStatus(failures=4, error="unplugged", gaps=[Gap(s, 3 * s, "unplugged")])
    mqtt = SinkStatus(rows=7, queued=2, waiting=4, unstored=1, dropped=5, failures=3)
    mqtt.error = "mqtt://host: refused"
    run.sinks["mqtt"], run.sinks["dataset"] = mqtt, SinkStatus(rows=9, unstored=6)
    found = read(metrics)
    expected = {
        key("slipflow_run_info", session="run1", flow="live", live="true", recording=""): 1,
        key("slipflow_source_rows_total", source="touch"): 500,
        key("slipflow_source_late_rows_total", source="touch"): 3,
        key("slipflow_source_lag_seconds", source="touch"): pytest.approx(0.03),
        key("slipflow_source_up", source="touch"): 1,
        key("slipflow_source_up", source=strange): 0,
        key("slipflow_source_failures_total", source=strange): 4,
        key("slipflow_source_gaps_total", source=strange): 1,
        key("slipflow_sink_up", sink="mqtt"): 0,
        key("slipflow_sink_up", sink="dataset"): 1,
        key("slipflow_sink_rows_total", sink="mqtt"): 7,
        key("slipflow_sink_queued_batches", sink="mqtt"): 2,
        key("slipflow_sink_dropped_rows_total", sink="mqtt"): 5,
        key("slipflow_sink_failures_total", sink="mqtt"): 3,
        key("slipflow_sink_waiting_rows", sink="mqtt"): 4,
        key("slipflow_sink_unstored_rows", sink="dataset"): 6,
    }
    assert {name: found[name] for name in expected} == expected
    assert key("slipflow_sink_waiting_rows", sink="dataset") not in found  # it acknowledges nothing
    assert key("slipflow_source_lag_seconds", source=strange) not in found
    assert b"refused" not in metrics.text()
    run.sources["touch"].rows = 600
    assert read(metrics)[key("slipflow_source_rows_total", source="touch")] == 600


@pytest.mark.parametrize("recording", [None, "stroke-9"])
def test_slips_are_counted_and_their_latency_is_a_histogram_unless_replayed(
    run: Run, recording: str | None
) -> None:
    run.recording = recording
    metrics = RunMetrics(run)
    metrics.add(slips(NOW - 3 * ms, NOW - 15 * ms, NOW - 9 * s))
    metrics.add(slips(NOW - 4 * ms, state=0))
    metrics.add(slips(NOW, finger=2))
    found = read(metrics)
    events = [found[key("slipflow_slip_events_total", finger="0", state=each)] for each in ("onset", "end")]
    assert events == [3, 1]
    bucket = "slipflow_slip_latency_seconds_bucket"
    counts = [found.get(key(bucket, finger="0", le=le)) for le in ("0.002", "0.005", "0.02", "5.0", "+Inf")]
    assert counts == ([0, 2, 3, 3, 4] if recording is None else [None] * 5)


def test_faults_last_and_scores_are_counted_by_quality(run: Run) -> None:
    def fault(*, active: bool) -> Faults:
        kind = np.full(1, FaultKind.STUCK, np.int8)
        return Faults(np.array([s]), np.array([3], np.int8), kind, np.array([active]), finger=1)

    metrics, name = RunMetrics(run), key("slipflow_barometer_fault", finger="1", barometer="3", kind="stuck")
    for batch in (scored(0, 0.1, finger=1), scored(1, np.nan, finger=1), fault(active=True)):
        metrics.add(batch)
    metrics.add(scored(2, 0.1, finger=1))
    assert read(metrics)[name] == 1
    metrics.add(fault(active=False))
    metrics.add(scored(3, 0.1, finger=1))
    found = read(metrics)
    assert found[name] == 0
    counts = [
        found[key("slipflow_scores_total", finger="1", quality=each)]
        for each in ("good", "doubtful", "blind")
    ]
    assert counts == [2, 1, 1]


def test_clock_metrics_are_those_of_the_newest_row(run: Run) -> None:
    metrics, device = RunMetrics(run), "slipflow_device_clock_offset_seconds"
    found = read(metrics)
    assert found["slipflow_host_clock_offset_seconds"] == 0
    assert device not in found
    metrics.add(Clocks(np.array([s, 2 * s]), np.array([3 * s, 4 * s]), np.full(2, 5e-5), np.full(2, 4e-3)))
    metrics.add(Clocks.empty())
    run.clock_steps.append(ClockStep(NOW, -2 * s))
    found = read(metrics)
    assert found[device] == 4
    assert found["slipflow_host_clock_offset_seconds"] == -2
    assert found["slipflow_host_clock_steps_total"] == 1
