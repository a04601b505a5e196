"""Sink that serves a live page of a running flow."""

import asyncio
from collections.abc import Callable
from importlib.metadata import version
from typing import TYPE_CHECKING, Final

from connectors.health_report import HealthReports
from connectors.web.access import PAGE_PORT, http_url
from connectors.web.page_frames import Frames, Rows
from operators.batch import Faults, Motion, Scores, Slips, Touch, ms
from operators.checks import check_between
from operators.ports import Json, Run, Sink

if TYPE_CHECKING:
    from aiohttp import web

FRAME_EVERY: Final = 0.025  # s, shortest time between frames
GATHER: Final = 0.002  # s before a frame, so that it contains all rows derived from one sample
REPORT_EVERY: Final = 1.0  # s
_RECORDERS_POLL: Final = 0.02  # s
_RECORDERS_POLLS: Final = 50
_EVENTS_REPEATED: Final = 20  # newest events in each report, for pages that lost frames


class Page(Sink[Touch | Motion | Scores | Slips | Faults]):
    """Live page in the browser: pressure maps, slip probability, TCP speed, slip events with latency, health.

    Connect each stream to show: touch (preferably zeroed), motion, scores, slips, faults. The health covers
    all sources and sinks of the run. Frames are server-sent events, at most 40 per second, see
    `connectors.web.page_frames`. The page may drop rows and never slows the run.

    Only this machine can reach the page unless `host` is set, which requires a token. The connection is not
    encrypted: outside a trusted network, use a TLS proxy.

    Args:
        port: Port to listen on; 0 for any free port; None for 8765, or any free port if that is in use.
        host: Address of this machine to listen on, 0.0.0.0 for all.
        token: Token that a browser must send; None for that of the environment, see `connectors.web.access`.
        threshold: Probability from which a sample counts as slip, marked on the page.
        opened: Called with the URL once the page is open.

    Raises:
        ParameterError: if `port` or `threshold` is out of range.
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
        if port is not None:
            check_between("Page", "port", port, 0, 65535)
        if threshold is not None:
            check_between("Page", "threshold", threshold, 0, 1)
        self._host, self._port, self._token = host, port, token
        self.threshold, self._opened = threshold, opened
        self._sending: asyncio.TimerHandle | None = None
        self._sent = 0.0  # loop time (s) of the newest frame

    @property
    def destination(self) -> str:
        """URL of the page."""
        return http_url(self._host, PAGE_PORT if self._port is None else self._port)

    @property
    def url(self) -> str:
        """URL for a browser on this machine, once the page is open."""
        return self._server.url

    @property
    def login_url(self) -> str:
        """URL with the token, if there is one: keep it secret."""
        return self._server.login_url

    async def open(self, run: Run) -> None:
        """Start serving the page.

        Raises:
            EndpointError: if the server cannot listen on its address.
            ParameterError: if the token is malformed, or missing although other machines can reach `host`.
            InputError: if the file with the token cannot be read.
        """
        from connectors.web.event_feed import EventFeed  # noqa: PLC0415 - aiohttp is slow to import
        from connectors.web.web_server import page_server  # noqa: PLC0415 - as above

        self._run, self._frames, self._reports = run, Frames(run), HealthReports(run)
        self._health = self._reports.next()
        self._loop = asyncio.get_running_loop()
        self._feed = EventFeed(self._hello)
        self._server = page_server(self._host, self._port, self._token)
        await self._server.open({"/about.json": _about, "/stream": self._feed.stream})
        self._reporting = asyncio.create_task(self._keep_reporting())
        if self._opened:
            self._opened(self._server.url)

    async def write(self, batch: Touch | Motion | Scores | Slips | Faults) -> None:
        """Add the rows of a batch to the next frame."""
        self._frames.add(batch)
        if self._sending is None and len(self._feed):
            now = self._loop.time()
            self._sending = self._loop.call_at(max(now + GATHER, self._sent + FRAME_EVERY), self._send)
        if not self._run.live:  # otherwise a replay at full speed never yields
            await asyncio.sleep(0)

    async def close(self) -> None:
        """Send the last frame and the end of the run, and stop serving."""
        self._reporting.cancel()
        await asyncio.wait([self._reporting])
        if self._sending:
            self._sending.cancel()
            self._send()
        await self._wait_for_recorders()
        self._health = self._reports.next()
        report = self._report()
        final = {name: report[name] for name in ("sinks", "recorders")}
        self._feed.send("end", {"error": self._run.error or None, **final})
        await self._feed.close()
        await self._server.close()

    def _send(self) -> None:
        self._sending, self._sent = None, self._loop.time()
        self._feed.send("frame", self._frames.next())

    async def _hello(self) -> bytes:
        """Return the first messages to a page: the run with all kept rows, and a report."""
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
        return await asyncio.to_thread(_hello_messages, about, rows, run.start, report)

    def _report(self) -> dict[str, Json]:
        errors: dict[str, Json] = {name: source.error or None for name, source in self._run.sources.items()}
        recorders: list[Json] = [name for name, sink in self._run.sinks.items() if sink.records]
        return {**self._health, "errors": errors, "recorders": recorders}

    async def _wait_for_recorders(self) -> None:
        """Wait up to 1 s until the recorders, which close concurrently, have written their queues."""
        recorders = [sink for sink in self._run.sinks.values() if sink.records]
        for _ in range(_RECORDERS_POLLS if recorders and len(self._feed) else 0):
            before = [sink.rows for sink in recorders]
            await asyncio.sleep(_RECORDERS_POLL)
            if before == [sink.rows for sink in recorders] and not any(sink.queued for sink in recorders):
                return

    async def _keep_reporting(self) -> None:
        while True:
            await asyncio.sleep(REPORT_EVERY)
            self._health = self._reports.next()
            self._feed.send("report", {**self._report(), "events": self._frames.events(_EVENTS_REPEATED)})


def _hello_messages(about: dict[str, Json], rows: Rows, origin: int, report: dict[str, Json]) -> bytes:
    from connectors.web.event_feed import message  # noqa: PLC0415 - aiohttp is slow to import

    return message("hello", {**about, **rows.document(origin)}) + message("report", report)


async def _about(request: "web.Request") -> "web.Response":  # noqa: ARG001 - aiohttp's signature
    from aiohttp import web  # noqa: PLC0415 - slow to import

    return web.json_response({"mode": "live"})
