"""A line between two processes that can be cut, or fall silent."""

import asyncio
from contextlib import suppress
from threading import Thread
from types import TracebackType
from typing import Self


class Line:
    """A TCP proxy on loopback, in a thread of its own.

    While it is cut, connections are refused and those that stood are reset; while it is silent they stand,
    and are made, and nothing passes.
    """

    def __init__(self, port: int) -> None:
        """Lead to a port of loopback."""
        self._to = port
        self._loop = asyncio.new_event_loop()
        self._thread = Thread(target=self._loop.run_forever, daemon=True)
        self._flows = asyncio.Event()
        self._server: asyncio.Server | None = None
        self._writers = set[asyncio.StreamWriter]()
        self._serving = set[asyncio.Task[None]]()
        self.port = 0

    def __enter__(self) -> Self:
        """Begin whole."""
        self._thread.start()
        self.mend()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Cut it for good."""
        self.cut()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    @property
    def url(self) -> str:
        """Its address, as that of a broker."""
        return f"mqtt://127.0.0.1:{self.port}"

    def cut(self) -> None:
        """Let nothing and nobody through."""
        asyncio.run_coroutine_threadsafe(self._cut(), self._loop).result()

    def hush(self) -> None:
        """Fall silent."""
        self._loop.call_soon_threadsafe(self._flows.clear)

    def mend(self) -> None:
        """Let all through."""
        asyncio.run_coroutine_threadsafe(self._mend(), self._loop).result()

    async def _mend(self) -> None:
        self._flows.set()
        if self._server is None:
            self._server = await asyncio.start_server(self._accept, "127.0.0.1", self.port)
            self.port = self._server.sockets[0].getsockname()[1]

    async def _cut(self) -> None:
        if self._server:
            self._server.close()
        self._server = None
        for writer in self._writers:
            writer.transport.abort()
        self._flows.set()  # for those that wait to notice
        await asyncio.gather(*self._serving, return_exceptions=True)

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        serving = self._loop.create_task(self._serve(reader, writer))
        self._serving.add(serving)
        serving.add_done_callback(self._serving.discard)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        away: asyncio.StreamWriter | None = None
        try:
            await self._flows.wait()
            back, away = await asyncio.open_connection("127.0.0.1", self._to)
            self._writers.add(away)
            there, here = self._carry(reader, away), self._carry(back, writer)
            tasks = [asyncio.create_task(there), asyncio.create_task(here)]
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        except OSError:
            pass  # as if there were nobody
        finally:
            for end in (writer, away):
                if end:
                    end.transport.abort()
                    self._writers.discard(end)

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            while data := await reader.read(65536):
                await self._flows.wait()
                writer.write(data)
                await writer.drain()
