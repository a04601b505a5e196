"""Sink that serves metrics of a run to Prometheus."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from connectors.web.access import METRICS_PORT, Access, http_url, is_loopback
from operators.batch import Faults, Scores, Slips
from operators.checks import check_between
from operators.ports import Run, Sink

if TYPE_CHECKING:
    from aiohttp.web import Request, Response

PATH: Final = "/metrics"


class Metrics(Sink[Scores | Slips | Faults]):
    """Prometheus metrics at ``/metrics`` (text format 0.0.4), and probes of a run, while it lasts.

    ``/healthz`` answers 200 while the event loop runs. ``/readyz`` answers 200 if a source delivers and no
    source or sink fails, else 503 with the names of those that fail. Neither needs the token.

    The metrics cover all sources and sinks of the run. Connect slips for counts and latency, faults for the
    health of barometers, and scores for their quality. The sink may drop rows and never slows the run.

    Only this machine can read the metrics unless `host` is set, which requires a token: Prometheus sends it
    as ``Authorization: Bearer TOKEN``. The metrics have names, counts and times, but no error texts.

    Args:
        port: Port to listen on; 0 for any free port.
        host: Address of this machine to listen on, 0.0.0.0 for all.
        opened: Called with the URL once the metrics are served.

    Raises:
        ParameterError: if `port` is out of range.
    """

    lossless = False

    def __init__(
        self,
        port: int = METRICS_PORT,
        host: str = "127.0.0.1",
        *,
        opened: Callable[[str], None] | None = None,
    ) -> None:
        check_between("Metrics", "port", port, 0, 65535)
        self._host, self._port, self._opened = host, port, opened

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
            ParameterError: if the token is malformed, or missing although other machines can reach `host`.
        """
        from aiohttp import web

        from connectors.web.run_metrics import RunMetrics
        from connectors.web.web_server import HEALTH, READY, WebServer

        self._metrics = RunMetrics(run)

        async def metrics(request: "Request") -> "Response":
            headers = {"Content-Type": "text/plain; version=0.0.4; charset=utf-8"}
            return web.Response(body=self._metrics.text(), headers=headers)

        async def healthy(request: "Request") -> "Response":
            return web.Response(text="ok\n")

        async def ready(request: "Request") -> "Response":
            failing = unready(run)
            return web.Response(status=503, text=f"{failing}\n") if failing else await healthy(request)

        access = Access() if is_loopback(self._host) else Access.of("Metrics", self._host)
        self._server = WebServer(self._host, self._port, access, "metrics")
        await self._server.open(web.get(PATH, metrics), web.get(HEALTH, healthy), web.get(READY, ready))
        if self._opened:
            self._opened(self.url)

    def take(self, batch: Scores | Slips | Faults) -> bool:
        """Add the rows of a batch to the metrics."""
        self._metrics.add(batch)
        return True

    async def close(self) -> None:
        """Stop serving, so that Prometheus marks the run as down."""
        await self._server.close()


def unready(run: Run) -> str:
    """Return why a run is not ready, without error texts; empty if it is ready."""
    failing = [name for name, source in run.sources.items() if source.error]
    failing += [name for name, sink in run.sinks.items() if sink.error]
    if failing:
        return f"failing: {', '.join(failing)}"
    return "" if any(source.up for source in run.sources.values()) else "no source has delivered rows"
