"""Server-sent events: one stream of messages to each browser that looks on."""

import asyncio
import socket
import struct
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Final

from aiohttp import web

from connectors.web.sse_messages import message
from connectors.web.viewer import Viewer
from operators.ports import Json

VIEWERS: Final = 32
STALLED: Final = 10.0  # s, after which a browser that takes nothing is dropped
RETRY: Final = 1000  # ms, after which a browser comes back
FAREWELL: Final = 0.5  # s, for browsers to take what is left when it closes
_BUFFER: Final = 1 << 16  # bytes, that the kernel holds for one: what waits there cannot be thinned any more


class Feed:
    """Tells every browser the same, each at its own pace.

    One that is slow loses its oldest messages and is told how many; one that takes nothing for 10 s is
    dropped. So a browser costs 2 MiB at most, whatever it does.
    """

    def __init__(self, hello: Callable[[], Awaitable[bytes]], *, stalled: float = STALLED) -> None:
        """Begin each stream with `hello`, which is what the later messages add to."""
        self._hello, self._stalled = hello, stalled
        self._viewers: dict[Viewer, web.Request] = {}
        self._closed, self._nobody = False, asyncio.Event()  # looks any more, once it is closed
        self.dropped = 0  # browsers that took nothing

    def __len__(self) -> int:
        return len(self._viewers)

    @property
    def waiting(self) -> int:
        """Bytes that wait for all of them."""
        return sum(viewer.size for viewer in self._viewers)

    def tell(self, name: str, document: Json) -> None:
        """Send a message to all."""
        if self._viewers:
            text = message(name, document)
            for viewer in self._viewers:
                viewer.put(text)

    async def close(self) -> None:
        """End the streams once what waits is sent; who does not take it within 0.5 s is cut off."""
        self._closed = True
        if not self._viewers:
            return
        self._nobody.clear()
        for viewer in self._viewers:
            viewer.end()
        with suppress(TimeoutError):
            async with asyncio.timeout(FAREWELL):
                await self._nobody.wait()
        for request in self._viewers.values():
            _cut(request)

    async def stream(self, request: web.Request) -> web.StreamResponse:
        """One browser's stream, as long as it stays."""
        if len(self._viewers) >= VIEWERS:
            return web.Response(status=503, text=f"{VIEWERS} pages are open already: close one.\n")
        if self._closed:
            return web.Response(status=503, text="The run has ended.\n")
        response = web.StreamResponse()
        response.content_type, response.charset = "text/event-stream", "utf-8"
        viewer = Viewer()
        self._viewers[viewer] = request
        try:
            await response.prepare(request)
            _keep_short(request)
            await self._write(response, f"retry: {RETRY}\n\n".encode() + await self._hello())
            await self._carry(viewer, response)
        except TimeoutError:
            self.dropped += 1
            _cut(request)
        finally:
            del self._viewers[viewer]
            if not self._viewers:
                self._nobody.set()
        return response

    async def _carry(self, viewer: Viewer, response: web.StreamResponse) -> None:
        told = 0
        while (messages := await viewer.take()) is not None:
            if viewer.lost > told:
                told = viewer.lost
                messages += message("lost", told)
            await self._write(response, messages)

    async def _write(self, response: web.StreamResponse, messages: bytes) -> None:
        async with asyncio.timeout(self._stalled):
            await response.write(messages)


def _cut(request: web.Request) -> None:
    """Close a connection at once, and let the kernel forget what still waits in it."""
    if connection := request.get_extra_info("socket"):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    if request.transport:
        request.transport.abort()


def _keep_short(request: web.Request) -> None:
    if connection := request.get_extra_info("socket"):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)
