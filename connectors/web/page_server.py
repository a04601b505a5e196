"""Serving the page: its files, and what is to be shown."""

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from aiohttp import web

from connectors.web.access import Access
from connectors.web.address import PAGE_PORT
from connectors.web.http_server import Handler, WebServer

_KINDS: Final = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
_LOCKED: Final = "/locked.html"
_WRONG: Final = b'<p id="wrong" hidden>'  # of that page, shown where a token was given


class PageServer(WebServer):
    """A server of the page's files and of `handlers`; people without the token are asked for it."""

    public = frozenset({"/page.css", "/icon.svg"})  # what the page that asks looks like

    def __init__(self, host: str, port: int | None, token: str | None) -> None:
        """Get ready to listen on `port`; None: on 8765, or any that is free where that is taken.

        Raises:
            ParameterError: if it needs a token, or that is not one.
            InputError: if the file with the token cannot be read.
        """
        access = Access.of(host, token)
        super().__init__(host, PAGE_PORT if port is None else port, access, "the page", spare=port is None)

    async def open(self, handlers: Mapping[str, Handler]) -> None:
        """Listen.

        Raises:
            EndpointError: if the address cannot be had.
        """
        files = await asyncio.to_thread(_read_files)
        self._locked = files.pop(_LOCKED)[0]
        await super().open(
            {**{path: _file(content, kind) for path, (content, kind) in files.items()}, **handlers}
        )

    async def refuse(self, request: web.Request) -> web.Response:
        """For people a page that asks for the token, for programs a line of text."""
        if "text/html" not in request.headers.get("Accept", ""):
            return await super().refuse(request)
        shown = _WRONG.replace(b" hidden", b"") if "token" in request.query else _WRONG
        body = self._locked.replace(_WRONG, shown)
        return web.Response(status=401, body=body, content_type="text/html", charset="utf-8")


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
