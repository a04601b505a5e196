"""A flow as it runs, in a browser."""

import asyncio
from collections.abc import Callable
from importlib.metadata import version
from typing import TYPE_CHECKING, Final

from connectors.health_report import HealthReports
from connectors.web.address import PAGE_PORT, address
from connectors.web.page_frames import Frames, Rows
from connectors.web.sse_messages import message
from operators.batch import Faults, Motion, Scores, Slips, Touch, ms
from operators.errors import ParameterError
from operators.ports import Json, Run, Sink

if TYPE_CHECKING:
    from aiohttp import web

FRAME_EVERY: Final = 0.025  # s, at least
GATHER: Final = 0.002  # s, so that what one sample causes goes out together
REPORT_EVERY: Final = 1.0  # s
_SETTLE_EVERY: Final = 0.02  # s
_SETTLE: Final = 50  # times that, at most
_TOLD_AGAIN: Final = 20  # events, with each report: a browser that lost frames has them then


class Page(Sink[Touch | Motion | Scores | Slips | Faults]):
    """Shows a run to browsers: pressure maps, counts, probability, speed, slips with latency, health.

    Each stream that it is to show is sent ``to`` it: touch, best zeroed; motion; scores; slips; faults. The
    health of sources and sinks, recorders among them, is that of the run. Frames go out as server-sent
    events, at most 40 in a second; see `connectors.web.page_frames`. It may lose rows, and holds up nobody.

    The page is for this machine, unless `host` says otherwise; then there must be a token, and what is sent
    is not encrypted: beyond a network that you trust, put a proxy with TLS before it.

    Args:
        port: Where it listens; 0: any that is free; None: 8765, or any that is free where that is taken.
        host: An address of this machine, 0.0.0.0 for all of them.
        token: What a browser must have shown; None: that of the environment, see `connectors.web.access`.
        threshold: The probability from which a slip is decided, for the page to mark.
        opened: Told the address once it can be looked at.

    Raises:
        ParameterError: on a port or a threshold that cannot be.
    """

    lossless = False

    def __init__(
        self,
        port: int | None = None,
        host: str = "127.0.0.1",
        token: str | None = None,
        *,
        threshold: float | None = None,
        opened: Callable[[str], None] | None = None,
    ) -> None:
        if port is not None and not 0 <= port < 2**16:
            raise ParameterError("Page", "port", port, "from 0 to 65535")
        if threshold is not None and not 0 <= threshold <= 1:
            raise ParameterError("Page", "threshold", threshold, "from 0 to 1")
        self._host, self._port, self._token = host, port, token
        self.threshold, self._opened = threshold, opened
        self._sending: asyncio.TimerHandle | None = None
        self._sent = 0.0  # s of the loop, when the newest frame went out

    @property
    def destination(self) -> str:
        """Its address."""
        return address(self._host, PAGE_PORT if self._port is None else self._port)

    @property
    def url(self) -> str:
        """Where a browser on this machine finds it, once it is open."""
        return self._server.url

    @property
    def entrance(self) -> str:
        """The same with the token, if there is one: for nobody else to see."""
        return self._server.entrance

    async def open(self, run: Run) -> None:
        """Serve the page.

        Raises:
            EndpointError: if the address cannot be had.
            ParameterError: if it needs a token, or that is not one.
            InputError: if the file with the token cannot be read.
        """
        from connectors.web.event_feed import Feed  # noqa: PLC0415 - aiohttp takes its time to import
        from connectors.web.page_server import PageServer  # noqa: PLC0415 - the same

        self._run, self._frames, self._reports = run, Frames(run), HealthReports(run)
        self._health = self._reports.next()
        self._loop = asyncio.get_running_loop()
        self._feed = Feed(self._hello)
        self._server = PageServer(self._host, self._port, self._token)
        await self._server.open({"/about.json": _about, "/stream": self._feed.stream})
        self._reporting = asyncio.create_task(self._keep_reporting())
        if self._opened:
            self._opened(self._server.url)

    async def write(self, batch: Touch | Motion | Scores | Slips | Faults) -> None:
        """Take the rows of a batch, which go out with the next frame."""
        self._frames.add(batch)
        if self._sending is None and len(self._feed):
            now = self._loop.time()
            self._sending = self._loop.call_at(max(now + GATHER, self._sent + FRAME_EVERY), self._send)
        if not self._run.live:  # a replay at full speed waits for nothing else
            await asyncio.sleep(0)

    async def close(self) -> None:
        """Say that the run is over, and stop serving."""
        self._reporting.cancel()
        await asyncio.wait([self._reporting])
        if self._sending:
            self._sending.cancel()
            self._send()
        await self._settle()
        self._health = self._reports.next()
        report = self._report()
        final = {name: report[name] for name in ("sinks", "recorders")}
        self._feed.tell("end", {"error": self._run.error or None, **final})
        await self._feed.close()
        await self._server.close()

    def _send(self) -> None:
        self._sending, self._sent = None, self._loop.time()
        self._feed.tell("frame", self._frames.next())

    async def _hello(self) -> bytes:
        """What a browser is told first: the run, and all rows that are kept."""
        run = self._run
        about: dict[str, Json] = {
            "version": version("slipflow"),
            "session": run.session,
            "flow": run.flow,
            "live": run.live,
            "recording": run.recording,
            "start": run.start / ms,
            "threshold": self.threshold,
            "events": self._frames.events(),
            **self._frames.state(),
        }
        rows, report = self._frames.rows(), self._report()
        return await asyncio.to_thread(_greeting, about, rows, run.start, report)

    def _report(self) -> dict[str, Json]:
        errors: dict[str, Json] = {name: source.error or None for name, source in self._run.sources.items()}
        recorders: list[Json] = [name for name, sink in self._run.sinks.items() if sink.records]
        return {**self._health, "errors": errors, "recorders": recorders}

    async def _settle(self) -> None:
        """Let the recorders, which end at the same time, write what waits: their last count is told."""
        recorders = [sink for sink in self._run.sinks.values() if sink.records]
        for _ in range(_SETTLE if recorders and len(self._feed) else 0):
            before = [sink.rows for sink in recorders]
            await asyncio.sleep(_SETTLE_EVERY)
            if before == [sink.rows for sink in recorders] and not any(sink.queued for sink in recorders):
                return

    async def _keep_reporting(self) -> None:
        while True:
            await asyncio.sleep(REPORT_EVERY)
            self._health = self._reports.next()
            self._feed.tell("report", {**self._report(), "events": self._frames.events(_TOLD_AGAIN)})


def _greeting(about: dict[str, Json], rows: Rows, origin: int, report: dict[str, Json]) -> bytes:
    return message("hello", {**about, **rows.document(origin)}) + message("report", report)


async def _about(request: "web.Request") -> "web.Response":  # noqa: ARG001 - aiohttp's shape
    from aiohttp import web  # noqa: PLC0415 - takes its time to import

    return web.json_response({"mode": "live"})
