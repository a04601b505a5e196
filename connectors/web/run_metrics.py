"""Prometheus metrics of a run: names, units, labels."""

from collections.abc import Callable, Iterator
from typing import Final, TypeAlias, TypeVar

from prometheus_client import CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.registry import Collector

from connectors.events import Fault, faults, finger_name, quality, slips
from operators.batch import Clocks, Faults, Scores, Slips, s
from operators.ports import Run, SinkStatus, SourceStatus

BUCKETS: Final = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)  # s

Family: TypeAlias = type[CounterMetricFamily] | type[GaugeMetricFamily]
Status = TypeVar("Status")
# kind, name, help, value (None: not served)
Column: TypeAlias = tuple[Family, str, str, Callable[[Status], float | None]]

_SOURCE: Final[tuple[Column[SourceStatus], ...]] = (
    (GaugeMetricFamily, "up", "1 if the source is up, 0 if it is down or stale", lambda source: source.up),
    (GaugeMetricFamily, "stale", "1 if the source delivers nothing", lambda source: source.stale),
    (CounterMetricFamily, "rows", "Rows received", lambda source: source.rows),
    (CounterMetricFamily, "late_rows", "Rows that arrived after newer ones", lambda source: source.late),
    (CounterMetricFamily, "failures", "Failures, each followed by a restart", lambda source: source.failures),
    (CounterMetricFamily, "gaps", "Times without rows after a failure", lambda source: len(source.gaps)),
    (
        CounterMetricFamily,
        "gap_seconds",
        "Total length of all gaps",
        lambda source: sum(gap.end - gap.start for gap in source.gaps) / s,
    ),
)
_SINK: Final[tuple[Column[SinkStatus], ...]] = (
    (GaugeMetricFamily, "up", "1 if the sink works, 0 if it fails", lambda sink: not sink.error),
    (CounterMetricFamily, "rows", "Rows written", lambda sink: sink.rows),
    (GaugeMetricFamily, "queued_batches", "Batches in the queue", lambda sink: sink.queued),
    (
        GaugeMetricFamily,
        "waiting_rows",
        "Rows that the receiver has not acknowledged",
        lambda sink: sink.waiting,
    ),
    (GaugeMetricFamily, "unstored_rows", "Rows that a kill would lose", lambda sink: sink.unstored),
    (CounterMetricFamily, "dropped_rows", "Rows dropped", lambda sink: sink.dropped),
    (CounterMetricFamily, "failures", "Failed writes", lambda sink: sink.failures),
)


class RunMetrics(Collector):
    """Metrics of one run in SI units, as counters where possible, so that Prometheus can derive rates.

    The runner's counts are read on each scrape; slips, faults and clocks are collected on arrival. Error
    texts are omitted, because they may be confidential.
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        self._faults: dict[
            tuple[str, str, str], bool
        ] = {}  # True while active, by finger, barometer and kind
        self._scores = dict[tuple[str, str], int]()  # by finger and quality
        self._clock: tuple[float, float, float] | None = None  # offset s, drift s/s, residual s
        self._registry = CollectorRegistry()
        self._events = Counter(
            "slipflow_slip_events", "Slip events", ["finger", "state"], registry=self._registry
        )
        self._latency = Histogram(
            "slipflow_slip_latency_seconds",
            "Time from the deciding sample to the delivery of its event; live only",
            ["finger"],
            buckets=BUCKETS,
            registry=self._registry,
        )
        self._registry.register(self)

    def text(self) -> bytes:
        """Return all metrics in the text format 0.0.4."""
        return generate_latest(self._registry)

    def add(self, batch: Scores | Slips | Faults | Clocks) -> None:
        """Add the rows of a batch."""
        if isinstance(batch, Slips):
            self._add_slips(batch)
        elif isinstance(batch, Scores):
            self._add_scores(batch)
        elif isinstance(batch, Faults):
            finger = finger_name(batch.finger)
            for _, fault, begins in faults(batch):
                self._faults[finger, str(fault.barometer), fault.kind] = begins
        elif len(batch):
            newest = batch[-1:]
            self._clock = newest.offset.item() / s, newest.drift.item(), newest.residual.item()

    def _add_slips(self, batch: Slips) -> None:
        finger = finger_name(batch.finger)
        for slip in slips(batch):
            self._events.labels(finger, "onset" if slip.onset else "end").inc()
            if (latency := self._run.latency(slip.time)) is not None:
                self._latency.labels(finger).observe(latency / s)

    def _add_scores(self, batch: Scores) -> None:
        finger = finger_name(batch.finger)
        found = [
            Fault(int(barometer), kind)
            for (where, barometer, kind), active in self._faults.items()
            if active and where == finger
        ]
        for probability in batch.probability.tolist():
            key = finger, quality(probability, found)[0]
            self._scores[key] = self._scores.get(key, 0) + 1

    def collect(self) -> Iterator[Metric]:
        """Yield the current metrics; called by the registry on each scrape."""
        run = self._run
        about = {"session": run.session, "flow": run.flow, "live": str(run.live).lower()}
        about["recording"] = run.recording or ""  # empty: live rows
        yield InfoMetricFamily("slipflow_run", "The current run", about)
        yield GaugeMetricFamily("slipflow_run_start_time_seconds", "Start, since 1970 UTC", run.start / s)
        yield from _families("source", _SOURCE, run.sources)
        lag = GaugeMetricFamily("slipflow_source_lag_seconds", "Age of the newest row", labels=["source"])
        now = run.clock.now()
        for name, source in run.sources.items():
            if source.newest:
                lag.add_metric([name], (now - source.newest) / s)
        yield lag
        yield from _families("sink", _SINK, run.sinks)
        yield from self._clocks()
        fault = GaugeMetricFamily(
            "slipflow_barometer_fault", "1 while the fault lasts", labels=["finger", "barometer", "kind"]
        )
        for labels, active in self._faults.items():
            fault.add_metric(labels, active)
        yield fault
        scores = CounterMetricFamily("slipflow_scores", "Scored samples", labels=["finger", "quality"])
        for (finger, word), count in self._scores.items():
            scores.add_metric([finger, word], count)
        yield scores

    def _clocks(self) -> Iterator[Metric]:
        steps = self._run.clock_steps
        yield CounterMetricFamily("slipflow_host_clock_steps", "Times the host clock was set", len(steps))
        offset = steps[-1].offset / s if steps else 0.0
        yield GaugeMetricFamily(
            "slipflow_host_clock_offset_seconds", "Host clock minus clock of the run", offset
        )
        if self._clock is not None:
            offset, drift, residual = self._clock
            name = "slipflow_device_clock"
            yield GaugeMetricFamily(f"{name}_offset_seconds", "Host clock minus device clock", offset)
            yield GaugeMetricFamily(f"{name}_drift_ratio", "Drift of the offset, s/s", drift)
            yield GaugeMetricFamily(f"{name}_residual_seconds", "Mean delay of the device's rows", residual)


def _families(
    label: str, columns: tuple[Column[Status], ...], statuses: dict[str, Status]
) -> Iterator[Metric]:
    for kind, name, text, value in columns:
        family = kind(f"slipflow_{label}_{name}", text, labels=[label])
        for each, status in statuses.items():
            if (number := value(status)) is not None:
                family.add_metric([each], number)
        yield family
