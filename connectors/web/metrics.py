"""A run's metrics, for Prometheus."""

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from connectors.web.access import Access
from connectors.web.address import METRICS_PORT, address, is_loopback
from operators.batch import Clocks, Faults, Slips
from operators.errors import ParameterError
from operators.ports import Run, Sink

if TYPE_CHECKING:
    from aiohttp import web

PATH: Final = "/metrics"


class Metrics(Sink[Slips | Faults | Clocks]):
    """Serves ``/metrics`` in the Prometheus text format 0.0.4 while a run lasts.

    Sources and sinks are those of the run, whatever comes ``to`` it. Slips give the histogram of their
    latency, from event time to hand-over; faults the health of barometers; clocks the offset of a device's
    clock. It may lose rows, and holds up nobody.

    Only this machine reaches it, unless `host` says otherwise; then everybody who reaches the port may read
    it: names, counts and times, no text of an error.

    Args:
        port: Where it listens; 0: any that is free.
        host: An address of this machine, 0.0.0.0 for all of them.
        opened: Told the address once it can be asked.

    Raises:
        ParameterError: on a port that cannot be.
    """

    lossless = False

    def __init__(
        self,
        port: int = METRICS_PORT,
        host: str = "127.0.0.1",
        *,
        opened: Callable[[str], None] | None = None,
    ) -> None:
        if not 0 <= port < 2**16:
            raise ParameterError("Metrics", "port", port, "from 0 to 65535")
        self._host, self._port, self._opened = host, port, opened

    @property
    def destination(self) -> str:
        """Its address."""
        return address(self._host, self._port)

    @property
    def url(self) -> str:
        """Where it is found on this machine, once it is open."""
        return self._server.url + PATH

    async def open(self, run: Run) -> None:
        """Serve.

        Raises:
            EndpointError: if the address cannot be had.
        """
        from connectors.web.http_server import WebServer  # noqa: PLC0415 - aiohttp too
        from connectors.web.measures import Measures  # noqa: PLC0415 - prometheus_client takes its time

        self._run, self._measures = run, Measures(run)
        access = Access(any_name=not is_loopback(self._host))
        self._server = WebServer(self._host, self._port, access, "metrics")
        await self._server.open({PATH: self._give})
        if self._opened:
            self._opened(self.url)

    async def write(self, batch: Slips | Faults | Clocks) -> None:
        """Take the rows of a batch into the numbers."""
        self._measures.add(batch)
        if not self._run.live:  # a replay at full speed waits for nothing else
            await asyncio.sleep(0)

    async def close(self) -> None:
        """Stop serving: from then on Prometheus sees that the run is over."""
        await self._server.close()

    async def _give(self, request: "web.Request") -> "web.Response":  # noqa: ARG002 - aiohttp's shape
        from aiohttp import web  # noqa: PLC0415 - takes its time to import
        from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4  # noqa: PLC0415 - the same

        return web.Response(body=self._measures.text(), headers={"Content-Type": CONTENT_TYPE_PLAIN_0_0_4})
