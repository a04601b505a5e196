"""A run's numbers as Prometheus metrics: names, units, labels."""

from collections.abc import Iterator
from typing import Final

from prometheus_client import CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.registry import Collector

from connectors.events import faults, finger_name
from operators.batch import SLIP, Clocks, Faults, Slips, s
from operators.ports import Run

BUCKETS: Final = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)  # s


class Measures(Collector):
    """The metrics of one run, in SI units; rates are for Prometheus to derive from what only grows.

    What the runner counts is read when it is asked for; what streams tell is kept as it comes. Texts of
    errors are left out: they tell more than those who may see numbers need to know.
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        self._faults: dict[tuple[str, str, str], bool] = {}  # by finger, barometer, kind: whether it lasts
        self._clock: tuple[float, float, float] | None = None  # s, s/s, s: offset, drift, residual
        self._registry = CollectorRegistry()
        self._events = Counter(
            "slipflow_slip_events", "Slip events", ["finger", "state"], registry=self._registry
        )
        self._latency = Histogram(
            "slipflow_slip_latency_seconds",
            "From the time of the sample that decided to when its event was handed over; live only",
            ["finger"],
            buckets=BUCKETS,
            registry=self._registry,
        )
        self._registry.register(self)

    def text(self) -> bytes:
        """All of them in the text format 0.0.4."""
        return generate_latest(self._registry)

    def add(self, batch: Slips | Faults | Clocks) -> None:
        """Take in what a stream tells."""
        if isinstance(batch, Slips):
            self._add_slips(batch)
        elif isinstance(batch, Faults):
            finger = finger_name(batch.finger)
            for _, fault, begins in faults(batch):
                self._faults[finger, str(fault.barometer), fault.kind] = begins
        elif len(batch):
            newest = batch[-1:]
            self._clock = newest.offset.item() / s, newest.drift.item(), newest.residual.item()

    def _add_slips(self, batch: Slips) -> None:
        finger = finger_name(batch.finger)
        for time, state in zip(batch.time.tolist(), batch.state.tolist(), strict=True):
            self._events.labels(finger, "onset" if state == SLIP else "end").inc()
            if (latency := self._run.latency(time)) is not None:
                self._latency.labels(finger).observe(latency / s)

    def collect(self) -> Iterator[Metric]:
        """What holds now; the registry asks."""
        run = self._run
        about = {"session": run.session, "flow": run.flow, "live": str(run.live).lower()}
        about["recording"] = run.recording or ""  # empty: what is measured is new
        yield InfoMetricFamily("slipflow_run", "The run that is measured", about)
        yield GaugeMetricFamily("slipflow_run_start_time_seconds", "Since 1970 UTC", run.start / s)
        yield from self._sources()
        yield from self._sinks()
        yield from self._clocks()
        fault = GaugeMetricFamily(
            "slipflow_barometer_fault", "1 while it lasts", labels=["finger", "barometer", "kind"]
        )
        for labels, lasts in self._faults.items():
            fault.add_metric(labels, lasts)
        yield fault

    def _sources(self) -> Iterator[Metric]:
        now, sources = self._run.clock.now(), self._run.sources
        up = GaugeMetricFamily("slipflow_source_up", "1 if it gives rows, 0 if it failed", labels=["source"])
        rows = CounterMetricFamily("slipflow_source_rows", "Rows that it gave", labels=["source"])
        late = CounterMetricFamily(
            "slipflow_source_late_rows", "Rows that came after newer ones", labels=["source"]
        )
        lag = GaugeMetricFamily("slipflow_source_lag_seconds", "Age of its newest row", labels=["source"])
        failures = CounterMetricFamily(
            "slipflow_source_failures", "Times that it failed; each time it is restarted", labels=["source"]
        )
        gaps = CounterMetricFamily(
            "slipflow_source_gaps", "Spans without rows as it failed", labels=["source"]
        )
        lost = CounterMetricFamily("slipflow_source_gap_seconds", "Length of all gaps", labels=["source"])
        for name, source in sources.items():
            up.add_metric([name], source.up)
            rows.add_metric([name], source.rows)
            late.add_metric([name], source.late)
            failures.add_metric([name], source.failures)
            gaps.add_metric([name], len(source.gaps))
            lost.add_metric([name], sum(gap.end - gap.start for gap in source.gaps) / s)
            if source.newest:
                lag.add_metric([name], (now - source.newest) / s)
        yield from (up, rows, late, lag, failures, gaps, lost)

    def _sinks(self) -> Iterator[Metric]:
        up = GaugeMetricFamily("slipflow_sink_up", "1 if it takes rows, 0 if it fails", labels=["sink"])
        rows = CounterMetricFamily("slipflow_sink_rows", "Rows that it took", labels=["sink"])
        queued = GaugeMetricFamily("slipflow_sink_queued_batches", "Batches that wait", labels=["sink"])
        dropped = CounterMetricFamily(
            "slipflow_sink_dropped_rows", "Rows that were given up", labels=["sink"]
        )
        failures = CounterMetricFamily("slipflow_sink_failures", "Writes that failed", labels=["sink"])
        for name, sink in self._run.sinks.items():
            up.add_metric([name], not sink.error)
            rows.add_metric([name], sink.rows)
            queued.add_metric([name], sink.queued)
            dropped.add_metric([name], sink.dropped)
            failures.add_metric([name], sink.failures)
        yield from (up, rows, queued, dropped, failures)

    def _clocks(self) -> Iterator[Metric]:
        steps = self._run.clock_steps
        yield CounterMetricFamily("slipflow_host_clock_steps", "Times that it was set", len(steps))
        offset = steps[-1].offset / s if steps else 0.0
        yield GaugeMetricFamily(
            "slipflow_host_clock_offset_seconds", "The host's clock minus the run's", offset
        )
        if self._clock is not None:
            offset, drift, residual = self._clock
            yield GaugeMetricFamily(
                "slipflow_device_clock_offset_seconds", "The host's clock minus the device's", offset
            )
            yield GaugeMetricFamily("slipflow_device_clock_drift_ratio", "What the offset gains, s/s", drift)
            yield GaugeMetricFamily(
                "slipflow_device_clock_residual_seconds", "By which its rows came late, mean", residual
            )
