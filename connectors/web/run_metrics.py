"""Prometheus metrics of a run: names, units, labels."""

from collections.abc import Callable, Iterator, Mapping
from typing import Final, TypeAlias, TypeVar

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.registry import Collector

from connectors.events import Fault, faults, finger_name, quality, slips
from operators.batch import Faults, Scores, Slips, s
from operators.ports import Run, SinkStatus, SourceStatus

BUCKETS: Final = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)  # s

Status = TypeVar("Status")
# kind, name, help, value (None: not served)
Column: TypeAlias = tuple[
    type[CounterMetricFamily] | type[GaugeMetricFamily], str, str, Callable[[Status], float | None]
]
_SOURCE: Final[tuple[Column[SourceStatus], ...]] = (
    (GaugeMetricFamily, "up", "1 if the source is up, 0 if it is down or stale", lambda each: each.up),
    (CounterMetricFamily, "rows", "Rows received", lambda each: each.rows),
    (CounterMetricFamily, "late_rows", "Rows that arrived after newer ones", lambda each: each.late),
    (CounterMetricFamily, "failures", "Failures, each followed by a restart", lambda each: each.failures),
    (CounterMetricFamily, "gaps", "Times without rows after a failure", lambda each: len(each.gaps)),
)
_SINK: Final[tuple[Column[SinkStatus], ...]] = (
    (GaugeMetricFamily, "up", "1 if the sink works, 0 if it fails", lambda each: not each.error),
    (CounterMetricFamily, "rows", "Rows written", lambda each: each.rows),
    (GaugeMetricFamily, "queued_batches", "Batches in the queue", lambda each: each.queued),
    (GaugeMetricFamily, "waiting_rows", "Rows that are not acknowledged", lambda each: each.waiting),
    (GaugeMetricFamily, "unstored_rows", "Rows that a kill would lose", lambda each: each.unstored),
    (CounterMetricFamily, "dropped_rows", "Rows dropped", lambda each: each.dropped),
    (CounterMetricFamily, "failures", "Failed writes", lambda each: each.failures),
)


class RunMetrics(Collector):
    """Metrics of one run in SI units, as counters where possible, so that Prometheus can derive rates.

    The runner's counts are read on each scrape; slips, faults and scores are collected on arrival.
    Error texts are omitted, because they may be confidential.
    """

    def __init__(self, run: Run) -> None:
        self._run, self._registry = run, CollectorRegistry()
        self._faults: dict[str, set[Fault]] = {}  # active, by fingertip
        registry = self._registry
        self._events = Counter("slipflow_slip_events", "Slip events", ["finger", "state"], registry=registry)
        latency = "Time from the deciding sample to the delivery of its event; live only"
        name = "slipflow_slip_latency_seconds"
        self._latency = Histogram(name, latency, ["finger"], buckets=BUCKETS, registry=registry)
        self._scores = Counter("slipflow_scores", "Scored samples", ["finger", "quality"], registry=registry)
        labels = ["finger", "barometer", "kind"]
        self._fault = Gauge("slipflow_barometer_fault", "1 while the fault lasts", labels, registry=registry)
        registry.register(self)

    def text(self) -> bytes:
        """Return all metrics in the text format 0.0.4."""
        return generate_latest(self._registry)

    def add(self, batch: Scores | Slips | Faults) -> None:
        """Add the rows of a batch."""
        finger = finger_name(batch.finger)
        active = self._faults.setdefault(finger, set())
        if isinstance(batch, Slips):
            for slip in slips(batch):
                self._events.labels(finger, "onset" if slip.onset else "end").inc()
                if (latency := self._run.latency(slip.time)) is not None:
                    self._latency.labels(finger).observe(latency / s)
        elif isinstance(batch, Scores):
            for probability in batch.probability.tolist():
                self._scores.labels(finger, quality(probability, active)[0]).inc()
        else:
            for _, fault, begins in faults(batch):
                (active.add if begins else active.discard)(fault)
                self._fault.labels(finger, str(fault.barometer), fault.kind).set(begins)

    def collect(self) -> Iterator[Metric]:
        """Yield the runner's counts; called by the registry on each scrape."""
        run, now = self._run, self._run.clock.now()
        about = {"session": run.session, "flow": run.flow, "live": str(run.live).lower()}
        about["recording"] = run.recording or ""  # empty: live rows
        yield InfoMetricFamily("slipflow_run", "The current run", about)
        yield GaugeMetricFamily("slipflow_run_start_time_seconds", "Start, since 1970 UTC", run.start / s)
        yield from _families("source", _SOURCE, run.sources)
        lag = GaugeMetricFamily("slipflow_source_lag_seconds", "Age of the newest row", labels=["source"])
        for name, source in run.sources.items():
            if source.newest:
                lag.add_metric([name], (now - source.newest) / s)
        yield lag
        yield from _families("sink", _SINK, run.sinks)
        steps, clock = run.clock_steps, "slipflow_host_clock"
        yield CounterMetricFamily(f"{clock}_steps", "Times the host clock was set", len(steps))
        offset = steps[-1].offset / s if steps else 0.0
        yield GaugeMetricFamily(f"{clock}_offset_seconds", "Host clock minus clock of the run", offset)


def _families(
    label: str, columns: tuple[Column[Status], ...], statuses: Mapping[str, Status]
) -> Iterator[Metric]:
    for kind, name, text, value in columns:
        family = kind(f"slipflow_{label}_{name}", text, labels=[label])
        for each, status in statuses.items():
            if (number := value(status)) is not None:
                family.add_metric([each], number)
        yield family
