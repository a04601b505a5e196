"""Serving over HTTP, to those who may see it: the page, and the metrics."""

import errno
import os
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from typing import ClassVar, Final, TypeAlias

from aiohttp import web

from connectors.web.access import COOKIE, Access
from connectors.web.address import address, reachable
from operators.errors import EndpointError

Handler: TypeAlias = Callable[[web.Request], Awaitable[web.StreamResponse]]

_FAREWELL: Final = 0.5  # s, for answers that are on their way when it closes
_ADVICE: Final = {errno.EADDRINUSE: "choose another port", errno.EACCES: "choose a port from 1024 on"}
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'self'; base-uri 'none'; form-action 'self'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class WebServer:
    """An HTTP server that gives what it was told to give, and takes nothing."""

    public: ClassVar[frozenset[str]] = frozenset()  # paths that need no token

    def __init__(self, host: str, port: int, access: Access, what: str, *, spare: bool = False) -> None:
        """Get ready to serve `what`, as errors call it.

        It listens on `port`; on any that is free where that is 0, or is taken and a `spare` one will do.
        """
        self._host, self._port, self._access = host, port, access
        self._what, self._spare = what, spare
        self._runner: web.AppRunner | None = None

    @property
    def url(self) -> str:
        """Where it is found on this machine, once it is open."""
        return address(reachable(self._host), self._port)

    @property
    def entrance(self) -> str:
        """The same with the token, if there is one: for nobody else to see."""
        return f"{self.url}/?token={self._access.token}" if self._access.token else self.url

    async def open(self, handlers: Mapping[str, Handler]) -> None:
        """Listen, and answer with `handlers`, by path.

        Raises:
            EndpointError: if the address cannot be had.
        """
        app = web.Application(middlewares=[self._admit])
        app.on_response_prepare.append(_protect)
        for path, handler in handlers.items():
            app.router.add_get(path, handler)
        self._runner = web.AppRunner(
            app, access_log=None, handler_cancellation=True, shutdown_timeout=_FAREWELL
        )
        await self._runner.setup()
        try:
            await self._listen(self._runner)
        except OSError as error:
            await self.close()
            number = error.errno or 0
            reason = os.strerror(number) if number > 0 else error.strerror or error  # below: of name servers
            advice = _ADVICE.get(number, "choose an address of this machine")
            text = f"cannot serve {self._what} there: {reason}; {advice}"
            raise EndpointError(address(self._host, self._port), text) from None

    async def close(self) -> None:
        """Listen no more."""
        if self._runner:
            await self._runner.cleanup()
            self._runner = None

    async def refuse(self, request: web.Request) -> web.Response:  # noqa: ARG002 - others look at it
        """What those get who lack the token."""
        text = f"Only those see {self._what} who have its token: open its address with /?token=... behind it."
        return web.Response(status=401, text=f"{text}\n")

    async def _listen(self, runner: web.AppRunner) -> None:
        try:
            await web.TCPSite(runner, self._host, self._port).start()
        except OSError as error:
            if not self._spare or error.errno != errno.EADDRINUSE:
                raise
            await web.TCPSite(runner, self._host, 0).start()
        self._port = int(runner.addresses[0][1])

    @web.middleware
    async def _admit(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        if not self._access.is_named(request.host):
            text = "This server goes by its address, localhost or its machine's name only.\n"
            return web.Response(status=421, text=text)
        if (token := request.query.get("token")) is not None and self._access.knows(token):
            entered = web.Response(status=303, headers={"Location": "/"})  # the address bar forgets it
            entered.set_cookie(COOKIE, self._access.cookie, httponly=True, samesite="Lax", path="/")
            return entered
        if request.path not in self.public and not self._access.lets_in(request.cookies.get(COOKIE)):
            return await self.refuse(request)
        with suppress(ConnectionError):  # a browser that has gone
            return await handler(request)
        return web.Response()


async def _protect(request: web.Request, response: web.StreamResponse) -> None:  # noqa: ARG001 - aiohttp's shape
    response.headers.update(_HEADERS)
    response.headers.setdefault("Cache-Control", "no-store")
