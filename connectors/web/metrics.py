"""Sink that serves metrics of a run to Prometheus."""

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Final, TypeAlias, TypeVar

from connectors.events import Fault, faults, finger_name, quality, slips
from connectors.web.access import METRICS_PORT, http_url, is_loopback, required_token
from operators.batch import Faults, Scores, Slips, s
from operators.checks import check_between
from operators.ports import Run, Sink, SinkStatus, SourceStatus

if TYPE_CHECKING:
    from aiohttp.web import Request, Response
    from prometheus_client.metrics_core import Metric

PATH: Final = "/metrics"
BUCKETS: Final = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)  # s

_SUFFIX: Final = {"gauge": "", "counter": "_total", "info": "_info"}  # of the sample names of a kind

Status = TypeVar("Status")
# kind, name, help, value (None: not served)
Column: TypeAlias = tuple[str, str, str, Callable[[Status], float | None]]
_SOURCE: Final[tuple[Column[SourceStatus], ...]] = (
    ("gauge", "up", "1 if the source is up, 0 if it is down or stale", lambda each: each.up),
    ("counter", "rows", "Rows received", lambda each: each.rows),
    ("counter", "late_rows", "Rows that arrived after newer ones", lambda each: each.late),
    ("counter", "failures", "Failures, each followed by a restart", lambda each: each.failures),
    ("counter", "gaps", "Times without rows after a failure", lambda each: len(each.gaps)),
)
_SINK: Final[tuple[Column[SinkStatus], ...]] = (
    ("gauge", "up", "1 if the sink works, 0 if it fails", lambda each: not each.error),
    ("counter", "rows", "Rows written", lambda each: each.rows),
    ("gauge", "connected", "1 if the receiver is reached and refuses nothing", lambda each: each.connected),
    ("gauge", "queued_batches", "Batches in the queue, which a kill loses", lambda each: each.queued),
    ("gauge", "waiting_rows", "Rows that are not acknowledged", lambda each: each.waiting),
    ("gauge", "unstored_rows", "Rows taken, not stored, which a kill loses", lambda each: each.unstored),
    ("counter", "dropped_rows", "Rows dropped", lambda each: each.dropped),
    ("counter", "failures", "Failed writes", lambda each: each.failures),
)


class Metrics(Sink[Scores | Slips | Faults]):
    """Prometheus metrics at ``/metrics`` (text format 0.0.4), and probes of a run, while it lasts.

    ``/healthz`` answers 200 while the event loop runs. ``/readyz`` answers 200 if a source delivers and no
    source or sink fails, else 503 with the names of those that fail. Neither needs the token.

    The metrics cover all sources and sinks of the run, in SI units. Connect slips for counts and latency,
    faults for the health of barometers, and scores for their quality. The sink may drop rows and never slows
    the run.

    Only this machine can read the metrics unless `host` is set, which requires SLIPFLOW_PAGE_TOKEN:
    Prometheus sends the token as ``Authorization: Bearer TOKEN``. The metrics contain no error texts.

    Args:
        port: Port to listen on; 0 for any free port.
        host: Address of this machine to listen on, 0.0.0.0 for all.
        opened: Called with the URL of the metrics once they are served.

    Raises:
        ParameterError: if `port` is out of range; if other machines can reach `host` and the token is missing
            or malformed.
    """

    lossless = False

    def __init__(
        self,
        port: int = METRICS_PORT,
        host: str = "127.0.0.1",
        opened: Callable[[str], None] = lambda url: None,
    ) -> None:
        check_between("Metrics", "port", port, 0, 65535)
        self._host, self._port, self._opened = host, port, opened
        self._token = None if is_loopback(host) else required_token("Metrics", host)

    @property
    def destination(self) -> str:
        """URL of the server."""
        return http_url(self._host, self._port)

    @property
    def url(self) -> str:
        """URL of the metrics on this machine, once they are served."""
        return self._server.url + PATH

    async def open(self, run: Run) -> None:
        """Start serving the metrics.

        Raises:
            EndpointError: if the server cannot listen on its address.
        """
        from aiohttp import web
        from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest

        from connectors.web.web_server import HEALTH, READY, WebServer

        self._run, registry = run, CollectorRegistry()
        self._faults: dict[str, set[Fault]] = {}  # active, by fingertip
        self._events = Counter("slipflow_slip_events", "Slip events", ["finger", "state"], registry=registry)
        latency = "Time from the deciding sample to the delivery of its event; live only"
        name = "slipflow_slip_latency_seconds"
        self._latency = Histogram(name, latency, ["finger"], buckets=BUCKETS, registry=registry)
        self._scores = Counter("slipflow_scores", "Scored samples", ["finger", "quality"], registry=registry)
        labels = ["finger", "barometer", "kind"]
        self._fault = Gauge("slipflow_barometer_fault", "1 while the fault lasts", labels, registry=registry)
        registry.register(self)

        async def metrics(request: "Request") -> "Response":
            headers = {"Content-Type": "text/plain; version=0.0.4; charset=utf-8"}
            return web.Response(body=generate_latest(registry), headers=headers)

        async def healthy(request: "Request") -> "Response":
            return web.Response(text="ok\n")

        async def ready(request: "Request") -> "Response":
            failing = unready(run)
            return web.Response(status=503, text=f"{failing}\n") if failing else await healthy(request)

        self._server = WebServer("metrics", self._host, self._port, self._token)
        await self._server.open(web.get(PATH, metrics), web.get(HEALTH, healthy), web.get(READY, ready))
        self._opened(self.url)

    def take(self, batch: Scores | Slips | Faults) -> bool:
        """Add the rows of a batch to the metrics."""
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
        return True

    async def close(self) -> None:
        """Stop serving, so that Prometheus marks the run as down."""
        await self._server.close()

    def collect(self) -> "Iterator[Metric]":
        """Yield the runner's counts; called on each scrape."""
        run, now, steps = self._run, self._run.clock.now(), self._run.clock_steps
        yield _metric("info", "run", "The current run", ({"session": run.session, "flow": run.flow}, 1))
        yield _metric("gauge", "run_start_time_seconds", "Start, since 1970 UTC", ({}, run.start / s))
        yield from _table("source", _SOURCE, run.sources)
        ages = {name: (now - each.newest) / s for name, each in run.sources.items() if each.newest}
        lags = (({"source": name}, age) for name, age in ages.items())
        yield _metric("gauge", "source_lag_seconds", "Age of the newest row", *lags)
        yield from _table("sink", _SINK, run.sinks)
        yield _metric("counter", "host_clock_steps", "Times the host clock was set", ({}, len(steps)))
        text, offset = "Host clock minus clock of the run", steps[-1].offset / s if steps else 0.0
        yield _metric("gauge", "host_clock_offset_seconds", text, ({}, offset))


def _table(
    label: str, columns: tuple[Column[Status], ...], statuses: Mapping[str, Status]
) -> "Iterator[Metric]":
    """Yield the metrics of all sources, or of all sinks."""
    for kind, name, text, value in columns:
        values = {each: value(status) for each, status in statuses.items()}
        samples = (({label: each}, number) for each, number in values.items() if number is not None)
        yield _metric(kind, f"{label}_{name}", text, *samples)


def _metric(kind: str, name: str, text: str, *samples: tuple[dict[str, str], float]) -> "Metric":
    """Return a metric with its samples, labels and value each."""
    from prometheus_client.metrics_core import Metric

    metric = Metric(f"slipflow_{name}", text, kind)
    for labels, value in samples:
        metric.add_sample(metric.name + _SUFFIX[kind], labels, value)
    return metric


def unready(run: Run) -> str:
    """Return why a run is not ready, without error texts; empty if it is ready."""
    failing = [name for name, source in run.sources.items() if source.error]
    failing += [name for name, sink in run.sinks.items() if sink.error]
    if failing:
        return f"failing: {', '.join(failing)}"
    return "" if any(source.up for source in run.sources.values()) else "no source has delivered rows"
