"""Sink that serves a live page of a running flow."""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from connectors.events import encode
from connectors.health_report import HealthReports
from connectors.web.access import PAGE_PORT, http_url
from connectors.web.curves import page_fingertip
from connectors.web.page_frames import Frames, Rows, rows_json
from operators.batch import Faults, Motion, Scores, Slips, Touch, Zeroed, ms
from operators.checks import check_between
from operators.extras import software_version
from operators.ports import Json, Run, Sink

if TYPE_CHECKING:
    from aiohttp.web import Request, Response, WebSocketResponse

FRAME_EVERY: Final = 0.025  # s, shortest time between frames
REPORT_EVERY: Final = 1.0  # s
SILENCE: Final = 20.0  # s without a request of a browser until its connection is closed
_MESSAGE_MAX: Final = 1024  # bytes of a request


class Page(Sink[Touch | Motion | Scores | Slips | Faults]):
    """Live page in the browser: pressure maps, slip probability, TCP speed, slip events with latency, health.

    Connect each stream to show: touch (raw touch is ignored if there is zeroed touch, too), motion, scores,
    slips and faults. The health covers all sources and sinks of the run.

    A browser requests each frame over a WebSocket when it has shown the previous one, at most 40 per second.
    The frame has all that is new since then (`connectors.web.page_frames`), so a slow browser gets fewer and
    larger ones, at most the last 30 s. The page may drop rows and never slows the run.

    Only this machine can reach the page unless `host` is set, which requires SLIPFLOW_PAGE_TOKEN. The
    connection is not encrypted: outside a trusted network, use a TLS proxy that keeps the header Host.

    Args:
        port: Port to listen on; 0 for any free port; None for 8765, or any free port if that is in use.
        host: Address of this machine to listen on, 0.0.0.0 for all.
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
        *,
        threshold: float | None = None,
        opened: Callable[[str], None] | None = None,
    ) -> None:
        if port is not None:
            check_between("Page", "port", port, 0, 65535)
        if threshold is not None:
            check_between("Page", "threshold", threshold, 0, 1)
        self._host, self._port = host, port
        self.threshold, self._opened = threshold, opened

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
        """
        from aiohttp import web

        from connectors.web.web_server import PAGE_FILES, json_response, page_server

        self._zeroed = any(issubclass(kind, Zeroed) for kind in run.sink_types.get(self.destination, ()))
        self._run, self._frames = run, Frames(run, zeroed=self._zeroed)
        self._ended = False
        self._server = page_server(self._host, self._port)

        async def about(request: "Request") -> "Response":
            return json_response({"mode": "live"})

        async def live(request: "Request") -> "WebSocketResponse":
            socket = web.WebSocketResponse(receive_timeout=SILENCE, compress=False, max_msg_size=_MESSAGE_MAX)
            await socket.prepare(request)
            with suppress(TimeoutError):  # the browser is gone
                await self._follow(socket)
            return socket

        await self._server.open(*PAGE_FILES, web.get("/about.json", about), web.get("/live", live))
        if self._opened:
            self._opened(self._server.url)

    def take(self, batch: Touch | Motion | Scores | Slips | Faults) -> bool:
        """Add the rows of a batch to the next frame."""
        self._frames.add(batch)
        return True

    async def close(self) -> None:
        """Send the end of the run to browsers that ask within 0.5 s, and stop serving."""
        self._ended = True
        await self._server.close()

    async def _follow(self, socket: "WebSocketResponse") -> None:
        """Answer each request of a browser with what is new for it, until it leaves or the run ends."""
        frames, reports, clock = self._frames, HealthReports(self._run), asyncio.get_running_loop().time
        seen, next_report = -1, clock()
        async for _ in socket:
            while True:
                await asyncio.sleep(FRAME_EVERY)
                ended = self._ended
                if ended or frames.count != seen or clock() >= next_report:
                    break
            rows, frame = frames.since(seen)
            if seen < 0:
                frame["run"] = self._about()
            if clock() >= next_report:
                next_report = clock() + REPORT_EVERY
                frame["report"] = self._health(reports)
            if ended:
                frame["end"] = {"error": self._run.error or None}
            seen = frames.count
            await socket.send_str(await asyncio.to_thread(self._encoded, frame, rows))
            if ended:
                break

    def _encoded(self, frame: dict[str, Json], rows: list[Rows]) -> str:
        return encode({**frame, "rows": rows_json(rows, self._run.start)}).decode()

    def _about(self) -> dict[str, Json]:
        run = self._run
        return {
            "version": software_version(),
            "session": run.session,
            "flow": run.flow,
            "recording": run.recording,
            "start": run.start / ms,
            "threshold": self.threshold,
            "fingertip": page_fingertip(run, self.destination),
            "zeroed": self._zeroed,
        }

    def _health(self, reports: HealthReports) -> dict[str, Json]:
        """Return the health of the run, with its error texts, lost rows and recorders."""
        sources, sinks = self._run.sources, self._run.sinks
        return {
            **reports.next(),
            "errors": {name: source.error or None for name, source in sources.items()},
            "declared_hz": {name: source.declared_rate for name, source in sources.items()},
            "lost": {name: source.lost for name, source in sources.items()},
            "waiting": {name: sink.waiting for name, sink in sinks.items()},
            "recorders": [name for name, sink in sinks.items() if sink.records],
        }
