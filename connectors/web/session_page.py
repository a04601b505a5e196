"""Serving a recorded session to browsers that scrub through it."""

import asyncio
from collections.abc import Callable
from typing import Final

from aiohttp import web

from connectors.events import encode
from connectors.web.page_server import PageServer
from connectors.web.recorded_page import Recorded
from operators.ports import Json

_LONGEST: Final = 1e12  # ms
_WIDEST: Final = 8192  # columns of a picture


class Scrubber:
    """The page of a recorded session: ``/about.json`` tells of it, ``/window`` has its curves and figures."""

    def __init__(
        self, recorded: Recorded, port: int | None = None, host: str = "127.0.0.1", token: str | None = None
    ) -> None:
        """Get ready to serve it; `port`, `host` and `token` as for a `connectors.web.live_page.Page`.

        Raises:
            ParameterError: if it needs a token, or that is not one.
            InputError: if the file with the token cannot be read.
        """
        self._recorded = recorded
        self._server = PageServer(host, port, token)

    @property
    def url(self) -> str:
        """Where a browser on this machine finds it, once it is open."""
        return self._server.url

    @property
    def entrance(self) -> str:
        """The same with the token, if there is one: for nobody else to see."""
        return self._server.entrance

    async def open(self) -> None:
        """Serve it.

        Raises:
            EndpointError: if the address cannot be had.
        """
        await self._server.open({"/about.json": self._about, "/window": self._window})

    async def close(self) -> None:
        """Serve it no more."""
        await self._server.close()

    async def _about(self, request: web.Request) -> web.Response:  # noqa: ARG002 - aiohttp's shape
        return await _json(lambda: {"mode": "recorded", **self._recorded.contents()})

    async def _window(self, request: web.Request) -> web.Response:
        try:
            begin, end, at = (float(request.query[name]) for name in ("begin", "end", "at"))
            columns = int(request.query["columns"])
        except (KeyError, ValueError):
            return _refused()
        if not (-_LONGEST <= begin <= end <= _LONGEST and abs(at) <= _LONGEST and 0 < columns <= _WIDEST):
            return _refused()  # as is what is no number
        recorded = self._recorded
        return await _json(lambda: {**recorded.window(begin, end, columns), "at": recorded.figures(at)})


def _refused() -> web.Response:
    asked = "/window?begin=MS&end=MS&at=MS&columns=N: ms since the start of the session"
    return web.Response(status=400, text=f"{asked}; 1 to {_WIDEST} columns\n")


async def _json(document: Callable[[], dict[str, Json]]) -> web.Response:
    """What is made in a thread, as it may take some ms."""
    body = await asyncio.to_thread(lambda: encode(document()))
    return web.Response(body=body, content_type="application/json")
