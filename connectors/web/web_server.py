"""HTTP server of the pages and the metrics."""

import asyncio
import errno
import os
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Final, TypeAlias

from aiohttp import web

from connectors.web.access import COOKIE, PAGE_PORT, http_url, is_own_host, is_secret, required_token
from operators.errors import EndpointError, InputError, ParameterError

Handler: TypeAlias = Callable[[web.Request], Awaitable[web.StreamResponse]]

STATIC: Final = Path(__file__).parent / "static"
STRANGERS_MAX: Final = 32  # connections without access
IDLE_TIMEOUT: Final = 20.0  # s without a request, after which a connection is closed
_BACKLOG: Final = 16  # connections accepted at once; fewer than STRANGERS_MAX, so that those closed are open
_BODY_MAX: Final = 16 << 20  # bytes of a POST request
_SHUTDOWN_TIMEOUT: Final = 0.5  # s, for responses in progress
_REMEDIES: Final = {errno.EADDRINUSE: "choose another port", errno.EACCES: "choose a port of at least 1024"}
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'self'; base-uri 'none'; form-action 'self'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
HEALTH: Final = "/healthz"  # paths for probes, which have no token
READY: Final = "/readyz"


class WebServer:
    """HTTP server for requests with access: GET, and from its own pages POST and WebSockets.

    Without a token the Host header must be an IP address, localhost or the name of this machine. This
    prevents DNS rebinding: otherwise a foreign page whose host name resolves to this machine could read the
    page. With a token, a request needs the header ``Authorization: Bearer TOKEN``, or the cookie with the
    token, which is set when the token is sent once, as ``/?token=...``.

    A POST request and a WebSocket must have an Origin header that names the same host and port as their Host
    header. Browsers send the origin of the page, so that no other site can write or listen. Errors of
    handlers that the user can fix are responses with their text.

    Connections without access are limited to 32, so that a recording can always open its files. A further one
    replaces the oldest of them.

    Args:
        name: Name of the service in messages.
        host: Address to listen on.
        port: Port to listen on; 0 for any free port; None for 8765, or any free port if that is in use.
        token: Token that requests need; None: none.
    """

    def __init__(self, name: str, host: str, port: int | None, token: str | None) -> None:
        self._name, self._host, self._token = name, host, token
        self._any_port, self._port = port is None, PAGE_PORT if port is None else port
        self._strangers = dict[web.RequestHandler, None]()  # connections without access, the oldest first

    @property
    def url(self) -> str:
        """URL for this machine, once the server is open."""
        local = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self._host, self._host)  # noqa: S104
        return http_url(local, self._port)

    @property
    def login_url(self) -> str:
        """URL with the token, if there is one: keep it secret."""
        return f"{self.url}/?token={self._token}" if self._token else self.url

    async def open(self, *routes: web.AbstractRouteDef) -> None:
        """Listen, and serve the routes.

        Raises:
            EndpointError: if the server cannot listen on its address.
        """
        app = web.Application(middlewares=[self._admit, _guard], client_max_size=_BODY_MAX)
        app.on_response_prepare.append(_set_headers)
        app.add_routes(routes)
        self._runner = web.AppRunner(
            app,
            access_log=None,
            handler_cancellation=True,
            keepalive_timeout=IDLE_TIMEOUT,
            shutdown_timeout=_SHUTDOWN_TIMEOUT,
        )
        await self._runner.setup()
        try:
            self._listener = await self._listen()
        except OSError as error:
            await self._runner.cleanup()
            number = error.errno or 0  # negative: name resolution
            reason = os.strerror(number) if number > 0 else error.strerror or error
            remedy = _REMEDIES.get(number, "choose an address of this machine")
            text = f"cannot serve {self._name}: {reason}; {remedy}"
            raise EndpointError(http_url(self._host, self._port), text) from None
        self._port = int(self._listener.sockets[0].getsockname()[1])

    async def close(self) -> None:
        """Stop listening."""
        self._listener.close()
        await self._runner.cleanup()

    async def _listen(self) -> asyncio.Server:
        listen = asyncio.get_running_loop().create_server
        try:
            return await listen(self._connection, self._host, self._port, backlog=_BACKLOG)
        except OSError as error:
            if not self._any_port or error.errno != errno.EADDRINUSE:
                raise
            return await listen(self._connection, self._host, 0, backlog=_BACKLOG)

    def _connection(self) -> web.RequestHandler:
        """Return the protocol of a new connection."""
        server = self._runner.server
        assert server, "the runner is set up before the server listens"
        connection = server()
        self._strangers[connection] = None
        if len(self._strangers) > STRANGERS_MAX:
            oldest = next(iter(self._strangers))
            del self._strangers[oldest]
            if oldest.transport:
                oldest.transport.abort()
        return connection

    @web.middleware
    async def _admit(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        token, cookie = self._token, request.cookies.get(COOKIE)
        if token is None and not is_own_host(request.host):
            text = "Use the IP address, localhost or the host name of this machine.\n"
            return web.Response(status=421, text=text)
        if token is not None and is_secret(request.query.get("token"), token):
            redirect = web.Response(status=303, headers={"Location": "/"})  # without the token
            redirect.set_cookie(COOKIE, token, httponly=True, samesite="Lax", path="/")
            return redirect
        bearer = request.headers.get("Authorization")
        if token is None or is_secret(cookie, token) or is_secret(bearer, f"Bearer {token}"):
            self._strangers.pop(request.protocol, None)
        elif request.path not in {HEALTH, READY}:
            text = (
                f"Access to {self._name} needs its token: send the header 'Authorization: Bearer ...', or"
                " open /?token=... once in this browser.\n"
            )
            return web.Response(status=403, text=text)
        return await handler(request)


async def _index(_: web.Request) -> web.StreamResponse:
    return web.FileResponse(STATIC / "index.html")


PAGE_FILES: Final = (web.get("/", _index), web.static("/", STATIC))


def page_server(host: str, port: int | None) -> WebServer:
    """Return a server of a page, whose `open` gets `PAGE_FILES` too."""
    return WebServer("the page", host, port, required_token("Page", host))


@web.middleware
async def _guard(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Let only the server's own pages write or listen; turn errors into responses."""
    _, _, origin = request.headers.get("Origin", "").partition("://")
    writes = request.method not in {"GET", "HEAD"} or "Upgrade" in request.headers
    if writes and origin.lower() != request.host.lower():
        return web.Response(status=403, text="Only pages of this server can write or listen.\n")
    try:
        return await handler(request)
    except (InputError, ParameterError) as error:
        return web.Response(status=400, text=f"{error}\n")
    except EndpointError as error:
        return web.Response(status=503, text=f"{error}\n")
    except ConnectionError:  # the browser disconnected
        return web.Response()


async def _set_headers(request: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(_HEADERS)
