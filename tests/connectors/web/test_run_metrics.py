"""The text is read back by prometheus_client's own parser."""

import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families

from connectors.web.run_metrics import RunMetrics
from operators.batch import Clocks, Faults, Scores, Slips, ms, s
from operators.health import FaultKind
from operators.ports import ClockStep, Gap, Run, SinkStatus, SourceStatus

NOW = 100 * s
Labels = frozenset[tuple[str, str]]


def read(measures: RunMetrics) -> dict[tuple[str, Labels], float]:
    """Each sample by its name and labels."""
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(measures.text().decode())
        for sample in family.samples
    }


def at(found: dict[tuple[str, Labels], float], name: str, **labels: str) -> float:
    return found[name, frozenset(labels.items())]


def slips(*times: int, state: int = 1, finger: int = 0) -> Slips:
    time = np.array(times)
    return Slips(time, np.full(len(time), state, np.int8), time, np.full(len(time), 0.9), finger=finger)


def test_source_metrics_match_the_runners_counts(run: Run) -> None:
    measures = RunMetrics(run)
    run.sources["touch"] = SourceStatus(rows=500, late=3, newest=NOW - 30 * ms, up=True)
    run.sources["motion"] = SourceStatus(failures=4, error="unplugged", gaps=[Gap(s, 3 * s, "unplugged")])
    found = read(measures)
    assert at(found, "slipflow_source_rows_total", source="touch") == 500
    assert at(found, "slipflow_source_late_rows_total", source="touch") == 3
    assert at(found, "slipflow_source_lag_seconds", source="touch") == pytest.approx(0.03)
    assert [at(found, "slipflow_source_up", source=name) for name in ("touch", "motion")] == [1, 0]
    assert at(found, "slipflow_source_failures_total", source="motion") == 4
    assert at(found, "slipflow_source_gaps_total", source="motion") == 1
    assert at(found, "slipflow_source_gap_seconds_total", source="motion") == 2
    assert ("slipflow_source_lag_seconds", frozenset({("source", "motion")})) not in found
    run.sources["touch"].rows = 600
    assert at(read(measures), "slipflow_source_rows_total", source="touch") == 600


def test_sink_metrics_match_the_runners_counts(run: Run) -> None:
    mqtt = SinkStatus(rows=7, queued=2, waiting=4, unstored=1, dropped=5, failures=3)
    mqtt.error = "mqtt://host: refused"
    run.sinks["mqtt"], run.sinks["dataset"] = mqtt, SinkStatus(rows=9, unstored=6)
    measures = RunMetrics(run)
    found = read(measures)
    assert at(found, "slipflow_sink_rows_total", sink="mqtt") == 7
    assert at(found, "slipflow_sink_queued_batches", sink="mqtt") == 2
    assert at(found, "slipflow_sink_dropped_rows_total", sink="mqtt") == 5
    assert at(found, "slipflow_sink_failures_total", sink="mqtt") == 3
    assert [at(found, "slipflow_sink_unstored_rows", sink=name) for name in ("mqtt", "dataset")] == [1, 6]
    waiting = {dict(labels)["sink"]: value for (name, labels), value in found.items() if "waiting" in name}
    assert waiting == {"mqtt": 4}  # a dataset acknowledges nothing
    assert [at(found, "slipflow_sink_up", sink=name) for name in ("mqtt", "dataset")] == [0, 1]
    assert b"refused" not in measures.text()


def test_the_latency_of_slips_is_a_histogram_by_finger(run: Run) -> None:
    measures = RunMetrics(run)
    measures.add(slips(NOW - 3 * ms, NOW - 15 * ms, NOW - 9 * s))
    measures.add(slips(NOW - 4 * ms, state=0))
    measures.add(slips(NOW, finger=2))
    found = read(measures)
    counts = [
        at(found, "slipflow_slip_latency_seconds_bucket", finger="0", le=le)
        for le in ("0.002", "0.005", "0.02", "5.0", "+Inf")
    ]
    assert counts == [0, 2, 3, 3, 4]
    assert at(found, "slipflow_slip_latency_seconds_sum", finger="0") == pytest.approx(9.022)
    assert at(found, "slipflow_slip_latency_seconds_count", finger="2") == 1
    assert at(found, "slipflow_slip_events_total", finger="0", state="onset") == 3
    assert at(found, "slipflow_slip_events_total", finger="0", state="end") == 1


def test_a_replay_has_events_but_no_latency(run: Run) -> None:
    run.live = False
    measures = RunMetrics(run)
    measures.add(slips(s))
    found = read(measures)
    assert at(found, "slipflow_slip_events_total", finger="0", state="onset") == 1
    assert not any(name.startswith("slipflow_slip_latency") for name, _ in found)


def test_a_fault_metric_is_1_while_it_lasts(run: Run) -> None:
    def fault(*, active: bool) -> Faults:
        kind = np.full(1, FaultKind.STUCK, np.int8)
        return Faults(np.array([s]), np.array([3], np.int8), kind, np.array([active]), finger=1)

    measures, labels = RunMetrics(run), {"finger": "1", "barometer": "3", "kind": "stuck"}
    measures.add(fault(active=True))
    assert at(read(measures), "slipflow_barometer_fault", **labels) == 1
    measures.add(fault(active=False))
    assert at(read(measures), "slipflow_barometer_fault", **labels) == 0


def test_scored_samples_are_counted_by_quality(run: Run) -> None:
    measures, time = RunMetrics(run), np.arange(3)
    measures.add(Scores(time, np.array([0.1, np.nan, 0.9]), finger=1))
    kinds = np.array([3], np.int8), np.array([FaultKind.STUCK], np.int8), np.array([True])
    measures.add(Faults(time[:1], *kinds, finger=2))
    measures.add(Scores(time, np.zeros(3), finger=2))
    found = read(measures)
    expected = {("1", "good"): 2, ("1", "blind"): 1, ("2", "doubtful"): 3}
    for (finger, quality), count in expected.items():
        assert at(found, "slipflow_scores_total", finger=finger, quality=quality) == count


def test_clock_metrics_are_those_of_the_newest_row(run: Run) -> None:
    measures = RunMetrics(run)
    assert at(read(measures), "slipflow_host_clock_offset_seconds") == 0
    measures.add(Clocks(np.array([s, 2 * s]), np.array([3 * s, 4 * s]), np.full(2, 5e-5), np.full(2, 4e-3)))
    measures.add(Clocks.empty())
    run.clock_steps.append(ClockStep(NOW, -2 * s))
    found = read(measures)
    assert at(found, "slipflow_device_clock_offset_seconds") == 4
    assert at(found, "slipflow_device_clock_drift_ratio") == 5e-5
    assert at(found, "slipflow_device_clock_residual_seconds") == 4e-3
    assert at(found, "slipflow_host_clock_offset_seconds") == -2
    assert at(found, "slipflow_host_clock_steps_total") == 1


def test_a_name_with_quotes_and_line_ends_is_escaped(run: Run) -> None:
    run.sources['a "b"\n\\c'] = SourceStatus(rows=1)
    assert at(read(RunMetrics(run)), "slipflow_source_rows_total", source='a "b"\n\\c') == 1
    assert (
        at(read(RunMetrics(run)), "slipflow_run_info", session="run1", flow="live", live="true", recording="")
        == 1
    )


def test_a_paced_replay_names_its_recording_and_has_no_latency(run: Run) -> None:
    run.recording = "stroke-9"
    measures = RunMetrics(run)
    measures.add(slips(NOW - 10 * ms))
    found = read(measures)
    assert at(found, "slipflow_slip_events_total", finger="0", state="onset") == 1
    assert not [name for name, _ in found if name.startswith("slipflow_slip_latency")]
    about = {"session": "run1", "flow": "live", "live": "true", "recording": "stroke-9"}
    assert at(found, "slipflow_run_info", **about) == 1
