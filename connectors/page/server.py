"""Serving the page: its files, and what is to be shown, to those who may see it."""

import asyncio
import errno
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final, TypeAlias

from aiohttp import web

from connectors.page.access import COOKIE, Access
from connectors.page.address import PORT, address, reachable
from operators.errors import EndpointError

Handler: TypeAlias = Callable[[web.Request], Awaitable[web.StreamResponse]]

_FAREWELL: Final = 2.0  # s, for the browsers to take what is left
_KINDS: Final = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class PageServer:
    """An HTTP server of the page's files and of `handlers`, by path."""

    def __init__(self, host: str, port: int | None, access: Access) -> None:
        """Get ready to listen on `port`; None: on 8765, or any that is free where that is taken."""
        self._host, self._port, self._access = host, port, access
        self._runner: web.AppRunner | None = None

    @property
    def url(self) -> str:
        """Where a browser on this machine finds it, once it is open."""
        return address(reachable(self._host), self._port)

    async def open(self, handlers: Mapping[str, Handler]) -> None:
        """Listen.

        Raises:
            EndpointError: if that cannot be.
        """
        app = web.Application(middlewares=[self._admit])
        app.on_response_prepare.append(_protect)
        for path, (content, kind) in (await asyncio.to_thread(_read_files)).items():
            app.router.add_get(path, _file(content, kind))
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
            reason = f"cannot serve the page there: {error.strerror or error}"
            raise EndpointError(address(self._host, self._port), reason) from None

    async def close(self) -> None:
        """Let the browsers go and listen no more."""
        if self._runner:
            await self._runner.cleanup()
            self._runner = None

    async def _listen(self, runner: web.AppRunner) -> None:
        try:
            await web.TCPSite(runner, self._host, PORT if self._port is None else self._port).start()
        except OSError as error:
            if self._port is not None or error.errno != errno.EADDRINUSE:
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
        if not self._access.lets_in(request.cookies.get(COOKIE)):
            text = "This page is for those who have its token: open its address with /?token=... behind it.\n"
            return web.Response(status=401, text=text)
        with suppress(ConnectionError):  # a browser that has gone
            return await handler(request)
        return web.Response()


async def _protect(request: web.Request, response: web.StreamResponse) -> None:  # noqa: ARG001 - aiohttp's shape
    response.headers.update(_HEADERS)
    response.headers.setdefault("Cache-Control", "no-store")


def _read_files() -> dict[str, tuple[bytes, str]]:
    """The page's files and their types, by path."""
    folder = Path(__file__).parent / "static"
    found = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
    return {
        f"/{name if name != 'index.html' else ''}": (path.read_bytes(), _KINDS.get(path.suffix, "text/plain"))
        for name, path in found.items()
    }


def _file(content: bytes, kind: str) -> Handler:
    async def give(request: web.Request) -> web.Response:  # noqa: ARG001 - aiohttp's shape
        return web.Response(body=content, content_type=kind, charset="utf-8")

    return give
