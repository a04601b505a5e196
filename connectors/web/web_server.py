"""HTTP server of the pages and the metrics."""

import asyncio
import errno
import os
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final, TypeAlias

from aiohttp import web

from connectors.web.access import COOKIE, PAGE_PORT, Access, http_url, local_host
from operators.errors import EndpointError

Handler: TypeAlias = Callable[[web.Request], Awaitable[web.StreamResponse]]

STATIC: Final = Path(__file__).parent / "static"
_SHUTDOWN_TIMEOUT: Final = 0.5  # s, for responses in progress
_REMEDIES: Final = {errno.EADDRINUSE: "choose another port", errno.EACCES: "choose a port of at least 1024"}
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'self'; base-uri 'none'; form-action 'self'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}
_TYPES: Final = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
_LOCKED: Final = "/locked.html"  # page that asks for the token
_WRONG: Final = b'<p id="wrong" hidden>'  # element of that page, shown after a wrong token
_PUBLIC: Final = frozenset({"/page.css", "/icon.svg"})  # used by that page


class WebServer:
    """HTTP server for GET requests that `Access` admits."""

    def __init__(
        self,
        host: str,
        port: int,
        access: Access,
        name: str,
        *,
        any_port: bool = False,
        files: Path | None = None,
    ) -> None:
        """Prepare to serve.

        Args:
            host: Address to listen on.
            port: Port to listen on; 0 for any free port.
            access: Access rules.
            name: Name of the service in messages.
            any_port: Use any free port if `port` is in use.
            files: Folder of static files, with a page that asks for the token.
        """
        self._host, self._port, self._access = host, port, access
        self._name, self._any_port, self._files = name, any_port, files
        self._locked: bytes | None = None
        self._runner: web.AppRunner | None = None

    @property
    def url(self) -> str:
        """URL for this machine, once the server is open."""
        return http_url(local_host(self._host), self._port)

    @property
    def login_url(self) -> str:
        """URL with the token, if there is one: keep it secret."""
        return f"{self.url}/?token={self._access.token}" if self._access.token else self.url

    async def open(self, handlers: Mapping[str, Handler]) -> None:
        """Listen, and serve the static files and `handlers`, by path.

        Raises:
            EndpointError: if the server cannot listen on its address.
        """
        app = web.Application(middlewares=[self._admit])
        app.on_response_prepare.append(_set_headers)
        files = await asyncio.to_thread(_read_files, self._files) if self._files else {}
        if _LOCKED in files:
            self._locked = files.pop(_LOCKED)[0]
        served = {path: _file(content, kind) for path, (content, kind) in files.items()}
        for path, handler in {**served, **handlers}.items():
            app.router.add_get(path, handler)
        self._runner = web.AppRunner(
            app, access_log=None, handler_cancellation=True, shutdown_timeout=_SHUTDOWN_TIMEOUT
        )
        await self._runner.setup()
        try:
            await self._listen(self._runner)
        except OSError as error:
            await self.close()
            number = error.errno or 0
            reason = (
                os.strerror(number) if number > 0 else error.strerror or error
            )  # negative: name resolution
            remedy = _REMEDIES.get(number, "choose an address of this machine")
            text = f"cannot serve {self._name}: {reason}; {remedy}"
            raise EndpointError(http_url(self._host, self._port), text) from None

    async def close(self) -> None:
        """Stop listening."""
        if self._runner:
            await self._runner.cleanup()
            self._runner = None

    async def _listen(self, runner: web.AppRunner) -> None:
        try:
            await web.TCPSite(runner, self._host, self._port).start()
        except OSError as error:
            if not self._any_port or error.errno != errno.EADDRINUSE:
                raise
            await web.TCPSite(runner, self._host, 0).start()
        self._port = int(runner.addresses[0][1])

    @web.middleware
    async def _admit(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        if not self._access.is_own_host(request.host):
            text = "Use the IP address, localhost or the host name of this machine.\n"
            return web.Response(status=421, text=text)
        token = request.query.get("token")
        if token is not None and self._access.accepts_token(token):
            redirect = web.Response(status=303, headers={"Location": "/"})  # without the token
            redirect.set_cookie(COOKIE, self._access.cookie, httponly=True, samesite="Lax", path="/")
            return redirect
        public = self._files is not None and request.path in _PUBLIC
        if not public and not self._access.accepts_cookie(request.cookies.get(COOKIE)):
            return self._refuse(request)
        with suppress(ConnectionError):  # the browser disconnected
            return await handler(request)
        return web.Response()

    def _refuse(self, request: web.Request) -> web.Response:
        """Request the token: from browsers with a page, from programs with a line of text."""
        if self._locked is None or "text/html" not in request.headers.get("Accept", ""):
            text = f"Access to {self._name} needs its token: append /?token=... to the address.\n"
            return web.Response(status=401, text=text)
        shown = _WRONG.replace(b" hidden", b"") if "token" in request.query else _WRONG
        body = self._locked.replace(_WRONG, shown)
        return web.Response(status=401, body=body, content_type="text/html", charset="utf-8")


def page_server(host: str, port: int | None, token: str | None) -> WebServer:
    """Return a server of the page's files; the default of `port` is 8765, or any free port if in use.

    Raises:
        ParameterError: if the token is malformed, or missing although other machines can reach `host`.
        InputError: if the file with the token cannot be read.
    """
    access = Access.of(host, token)
    number = PAGE_PORT if port is None else port
    return WebServer(host, number, access, "the page", any_port=port is None, files=STATIC)


async def _set_headers(request: web.Request, response: web.StreamResponse) -> None:  # noqa: ARG001 - aiohttp's signature
    response.headers.update(_HEADERS)
    response.headers.setdefault("Cache-Control", "no-store")


def _read_files(folder: Path) -> dict[str, tuple[bytes, str]]:
    """Read the files of a folder: content and type, by URL path."""
    found = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
    return {
        f"/{name if name != 'index.html' else ''}": (path.read_bytes(), _TYPES.get(path.suffix, "text/plain"))
        for name, path in found.items()
    }


def _file(content: bytes, kind: str) -> Handler:
    async def respond(request: web.Request) -> web.Response:  # noqa: ARG001 - aiohttp's signature
        return web.Response(body=content, content_type=kind, charset="utf-8")

    return respond
