"""Server-sent events: a stream of messages to each open page.

Source: https://html.spec.whatwg.org/multipage/server-sent-events.html.
"""

import asyncio
import socket
import struct
from collections import deque
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Final

from aiohttp import web

from connectors.events import encode
from operators.ports import Json

PAGES_MAX: Final = 32
QUEUE_MAX: Final = 1 << 20  # bytes per page
STALL_TIMEOUT: Final = 10.0  # s without reading, after which a browser is disconnected
RETRY: Final = 1000  # ms, until a disconnected browser reconnects
CLOSE_TIMEOUT: Final = 0.5  # s, to send the queued messages on close
_SOCKET_BUFFER: Final = 1 << 16  # bytes per page in the kernel, where messages cannot be dropped


def message(name: str, document: Json) -> bytes:
    r"""Return a message as a server-sent event.

    >>> message("lost", 3)
    b'event: lost\ndata: 3\n\n'
    """
    return b"event: %b\ndata: %b\n\n" % (name.encode(), encode(document))


class PageQueue:
    """Queue of messages for one page; drops the oldest if the browser is too slow."""

    def __init__(self, limit: int = QUEUE_MAX) -> None:
        """Create a queue of at most `limit` bytes; a longer message is dropped."""
        self.lost = 0  # dropped messages
        self.size = 0  # queued bytes
        self._limit = limit
        self._messages: deque[bytes] = deque()
        self._changed = asyncio.Event()
        self._ended = False

    def put(self, message: bytes) -> None:
        """Add a message; drop the oldest ones beyond the limit."""
        self._messages.append(message)
        self.size += len(message)
        while self.size > self._limit:
            self.size -= len(self._messages.popleft())
            self.lost += 1
        self._changed.set()

    def end(self) -> None:
        """Mark the end of the messages."""
        self._ended = True
        self._changed.set()

    async def take(self) -> bytes | None:
        """Wait for messages and return all of them joined; None after the end."""
        while not self._messages:
            if self._ended:
                return None
            self._changed.clear()
            await self._changed.wait()
        messages = b"".join(self._messages)
        self._messages.clear()
        self.size = 0
        return messages


class EventFeed:
    """Broadcast of messages to all pages, with a queue for each.

    A slow page loses its oldest messages and receives the number of lost ones; a page that reads nothing for
    10 s is disconnected. Each page needs at most 2 MiB.
    """

    def __init__(
        self, hello: Callable[[], Awaitable[bytes]], *, stall_timeout: float = STALL_TIMEOUT
    ) -> None:
        """Create a feed whose streams start with `hello`, the state that later messages extend."""
        self._hello, self._stall_timeout = hello, stall_timeout
        self._pages: dict[PageQueue, web.Request] = {}
        self._closed, self._empty = False, asyncio.Event()
        self.dropped = 0  # pages disconnected because they read nothing

    def __len__(self) -> int:
        return len(self._pages)

    @property
    def queued(self) -> int:
        """Bytes queued for all pages."""
        return sum(page.size for page in self._pages)

    def send(self, name: str, document: Json) -> None:
        """Send a message to all pages."""
        if self._pages:
            text = message(name, document)
            for page in self._pages:
                page.put(text)

    async def close(self) -> None:
        """End the streams after their queued messages; disconnect pages that need more than 0.5 s."""
        self._closed = True
        if not self._pages:
            return
        self._empty.clear()
        for page in self._pages:
            page.end()
        with suppress(TimeoutError):
            async with asyncio.timeout(CLOSE_TIMEOUT):
                await self._empty.wait()
        for request in self._pages.values():
            _abort(request)

    async def stream(self, request: web.Request) -> web.StreamResponse:
        """Serve the stream of one page until it disconnects."""
        if len(self._pages) >= PAGES_MAX:
            return web.Response(status=503, text=f"{PAGES_MAX} pages are open: close one.\n")
        if self._closed:
            return web.Response(status=503, text="The run has ended.\n")
        response = web.StreamResponse()
        response.content_type, response.charset = "text/event-stream", "utf-8"
        page = PageQueue()
        self._pages[page] = request
        try:
            await response.prepare(request)
            _limit_buffer(request)
            await self._write(response, f"retry: {RETRY}\n\n".encode() + await self._hello())
            await self._forward(page, response)
        except TimeoutError:
            self.dropped += 1
            _abort(request)
        finally:
            del self._pages[page]
            if not self._pages:
                self._empty.set()
        return response

    async def _forward(self, page: PageQueue, response: web.StreamResponse) -> None:
        reported = 0
        while (messages := await page.take()) is not None:
            if page.lost > reported:
                reported = page.lost
                messages += message("lost", reported)
            await self._write(response, messages)

    async def _write(self, response: web.StreamResponse, messages: bytes) -> None:
        async with asyncio.timeout(self._stall_timeout):
            await response.write(messages)


def _abort(request: web.Request) -> None:
    """Close a connection at once and discard its data in the kernel."""
    if connection := request.get_extra_info("socket"):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    if request.transport:
        request.transport.abort()


def _limit_buffer(request: web.Request) -> None:
    if connection := request.get_extra_info("socket"):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SOCKET_BUFFER)
