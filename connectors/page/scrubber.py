"""Serving a recorded session to browsers that scrub through it."""

import asyncio
from collections.abc import Callable
from math import isfinite
from typing import Final

from aiohttp import web

from connectors.events import encode
from connectors.page.access import Access
from connectors.page.recorded import Recorded
from connectors.page.server import PageServer
from operators.ports import Json

_LONGEST: Final = 1e12  # ms


class Scrubber:
    """The page of a recorded session: ``/about.json`` tells of it, ``/window?begin=..&end=..`` has curves."""

    def __init__(
        self, recorded: Recorded, port: int | None = None, host: str = "127.0.0.1", token: str | None = None
    ) -> None:
        """Get ready to serve it; `port`, `host` and `token` as for a `connectors.page.page.Page`.

        Raises:
            ParameterError: if it needs a token, or that is not one.
            InputError: if the file with the token cannot be read.
        """
        self._recorded = recorded
        self._server = PageServer(host, port, Access.of(host, token))

    async def open(self) -> str:
        """Serve it.

        Returns:
            Its address.

        Raises:
            EndpointError: if that cannot be had.
        """
        await self._server.open({"/about.json": self._about, "/window": self._window})
        return self._server.url

    async def close(self) -> None:
        """Serve it no more."""
        await self._server.close()

    async def _about(self, request: web.Request) -> web.Response:  # noqa: ARG002 - aiohttp's shape
        return await _json(lambda: {"mode": "recorded", **self._recorded.contents()})

    async def _window(self, request: web.Request) -> web.Response:
        try:
            begin, end = (float(request.query[name]) for name in ("begin", "end"))
        except (KeyError, ValueError):
            begin = end = float("nan")
        if not (isfinite(begin) and isfinite(end) and abs(begin) <= _LONGEST and begin <= end <= _LONGEST):
            return web.Response(status=400, text="/window?begin=MS&end=MS: since the start of the session\n")
        return await _json(lambda: self._recorded.window(begin, end))


async def _json(document: Callable[[], dict[str, Json]]) -> web.Response:
    """What is made in a thread, as it may take some ms."""
    body = await asyncio.to_thread(lambda: encode(document()))
    return web.Response(body=body, content_type="application/json")
