"""Serving metrics over HTTP."""

from collections.abc import Callable

from aiohttp import web
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4

from connectors.page.access import Access
from connectors.page.address import address, is_loopback, reachable
from operators.errors import EndpointError

PATH = "/metrics"


class MetricsServer:
    """An HTTP server that gives the same text to everyone who may come: read only, nothing else."""

    def __init__(self, host: str, port: int, text: Callable[[], bytes]) -> None:
        """Get ready to give what `text` says when it is asked for; port 0: any that is free."""
        self._host, self._port, self._text = host, port, text
        self._runner: web.AppRunner | None = None

    @property
    def url(self) -> str:
        """Where it is found on this machine, once it is open."""
        return address(reachable(self._host), self._port) + PATH

    async def open(self) -> None:
        """Listen.

        Raises:
            EndpointError: if that cannot be.
        """
        app = web.Application()
        app.router.add_get(PATH, self._give)
        self._runner = web.AppRunner(app, access_log=None, handler_cancellation=True, shutdown_timeout=1.0)
        await self._runner.setup()
        try:
            await web.TCPSite(self._runner, self._host, self._port).start()
        except OSError as error:
            await self.close()
            reason = f"cannot serve metrics there: {error.strerror or error}; choose another port"
            raise EndpointError(address(self._host, self._port), reason) from None
        self._port = int(self._runner.addresses[0][1])

    async def close(self) -> None:
        """Listen no more."""
        if self._runner:
            await self._runner.cleanup()
            self._runner = None

    async def _give(self, request: web.Request) -> web.Response:
        if is_loopback(self._host) and not Access().is_named(request.host):  # a web page in disguise
            return web.Response(status=421, text="This server goes by localhost or its address only.\n")
        return web.Response(body=self._text(), headers={"Content-Type": CONTENT_TYPE_PLAIN_0_0_4})
