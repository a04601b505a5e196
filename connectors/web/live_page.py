"""Sink that serves a live page of a running flow."""

import asyncio
import re
from collections import deque
from collections.abc import AsyncGenerator, Callable, Mapping
from contextlib import suppress
from typing import Final

from connectors.events import encode
from connectors.health_report import HealthReports
from connectors.web.access import PAGE_PORT, http_url
from connectors.web.curves import page_fingertip
from connectors.web.page_frames import Frames, Rows, rows_json
from connectors.web.verdicts import Verdicts
from operators.batch import Faults, Motion, Scores, Slips, Touch, Truth, ms
from operators.checks import check_between
from operators.ports import Clock, Finding, Json, Run, Sink
from operators.software import software_version
from storage.background_task import BackgroundTask

FRAME_EVERY: Final = 0.025  # s, shortest time between frames
GATHER: Final = 0.002  # s before a frame, so that it contains all rows derived from one sample
REPORT_EVERY: Final = 1.0  # s
WATCHED: Final = 3.0  # s since the last request of a browser, in which messages are made
BUFFER_MAX: Final = 4 << 20  # bytes of messages kept for browsers
_POLL: Final = 0.02  # s, between checks while the page closes
_POLLS: Final = 50  # until all recorders have written their queues
_END_POLLS: Final = 25  # until all browsers have fetched the end of the run
_NAME_MAX: Final = 64  # characters of a browser's name
_NUMBER: Final = re.compile(r"[0-9]{1,18}")  # of a message


class Page(Sink[Touch | Motion | Scores | Slips | Faults | Truth]):
    """Live page in the browser: pressure maps, slip probability, TCP speed, slip events with latency, health.

    Connect each stream to show: touch (preferably zeroed), motion, scores, slips, faults, and the truth
    of a simulation. The health covers all sources and sinks of the run, see `connectors.web.verdicts`.
    Browsers poll for messages: hello, frames (at most 40 per second, see `connectors.web.page_frames`),
    reports, and the end. A request waits until there are new ones. A browser that is too slow for the
    kept messages gets all kept rows again. The page may drop rows and never slows the run.

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

    async def diagnose(self, clock: Clock) -> AsyncGenerator[Finding]:  # noqa: ARG002 - needs none
        """Check that the page can be served: its port is free, and it has a token if other machines reach it.

        Raises:
            EndpointError: if the server cannot listen on its address.
            ParameterError: if the token is malformed or missing.
            InputError: if the file with the token cannot be read.
        """
        from connectors.web.web_server import page_server  # noqa: PLC0415 - aiohttp is slow to import

        server = page_server(self._host, self._port, self._token)
        await server.open({})
        await server.close()
        other = self._port is None and not server.url.endswith(f":{PAGE_PORT}")
        text = "is in use: a page uses a free port unless one is given" if other else "is free"
        yield Finding(self.destination, f"its port {text}", "note" if other else "good")

    async def open(self, run: Run) -> None:
        """Start serving the page.

        Raises:
            EndpointError: if the server cannot listen on its address.
            ParameterError: if the token is malformed, or missing although other machines can reach `host`.
            InputError: if the file with the token cannot be read.
        """
        from connectors.web.web_server import json_answer, page_server  # noqa: PLC0415 - aiohttp is slow to import

        self._run, self._frames, self._reports = run, Frames(run), HealthReports(run)
        self._verdicts = Verdicts(run)
        self._health = self._judged()
        self._loop = asyncio.get_running_loop()
        self._messages, self._ended = MessageBuffer(), False
        self._seen: dict[str, float] = {}  # loop time (s) of the last request of each browser
        self._server = page_server(self._host, self._port, self._token)

        async def about(query: Mapping[str, str]) -> tuple[bytes, str]:  # noqa: ARG001 - a constant
            return json_answer({"mode": "live"})

        await self._server.open({"/about.json": about, "/messages": self._answer})
        self._reporting = BackgroundTask(self.destination, "the health report", self._keep_reporting())
        if self._opened:
            self._opened(self._server.url)

    def take(self, batch: Touch | Motion | Scores | Slips | Faults | Truth) -> bool:
        """Add the rows of a batch to the next frame."""
        self._frames.add(batch)
        if self._sending is None and self._watched():
            now = self._loop.time()
            self._sending = self._loop.call_at(max(now + GATHER, self._sent + FRAME_EVERY), self._send)
        return True

    async def close(self) -> None:
        """Send the last frame and the end of the run, and stop serving.

        Raises:
            EndpointError: if a background task of the page has failed.
        """
        await self._reporting.end()
        if self._sending:
            self._sending.cancel()
            self._send()
        await self._wait_for_recorders()
        self._health = self._judged()
        report = self._report()
        final = {name: report[name] for name in ("sinks", "recorders", "waiting", "verdicts")}
        self._messages.put("end", {"error": self._run.error or None, **final})
        self._ended = True
        for _ in range(_END_POLLS):
            if self._watched():
                await asyncio.sleep(_POLL)
        await self._server.close()
        self._reporting.check()

    def _watched(self) -> bool:
        """Return True if a browser shows the page and has not fetched the end of the run."""
        now = self._loop.time()
        self._seen = {each: time for each, time in self._seen.items() if now - time < WATCHED}
        return bool(self._seen)

    def _send(self) -> None:
        self._sending, self._sent = None, self._loop.time()
        self._messages.put("frame", self._frames.next())

    async def _answer(self, query: Mapping[str, str]) -> tuple[bytes, str]:
        """Return the messages from number `next` of this run on; the first ones if those are dropped."""
        browser, number = query.get("browser", "")[:_NAME_MAX], query.get("next", "")
        if not self._ended:
            self._seen[browser] = self._loop.time()
        messages: list[bytes] | None = None
        if query.get("session") == self._run.session and _NUMBER.fullmatch(number):
            messages = await self._messages.since(int(number))
        end = self._messages.end
        if messages is None:
            end -= self._ended  # the end follows
            messages = await self._hello()
        elif self._ended:
            self._seen.pop(browser, None)
        return b'{"next":%d,"messages":[%b]}' % (end, b",".join(messages)), "application/json"

    async def _hello(self) -> list[bytes]:
        """Return the first messages to a browser: the run with all kept rows, and a report."""
        run = self._run
        about: dict[str, Json] = {
            "version": software_version(),
            "session": run.session,
            "flow": run.flow,
            "live": run.live,
            "recording": run.recording,
            "start": run.start / ms,
            "threshold": self.threshold,
            "fingertip": page_fingertip(run, self.destination),
            "events": self._frames.events(),
            **self._frames.state(),
        }
        rows, report = self._frames.rows(), self._report()
        return await asyncio.to_thread(_hello_messages, about, rows, run.start, report)

    def _judged(self) -> dict[str, Json]:
        """Return the health of the run with its verdicts."""
        health, sources, sinks = self._reports.next(), self._run.sources, self._run.sinks
        declared: dict[str, Json] = {name: source.declared_rate for name, source in sources.items()}
        lost: dict[str, Json] = {name: source.lost for name, source in sources.items()}
        waiting: dict[str, Json] = {name: sink.waiting for name, sink in sinks.items()}
        verdicts = self._verdicts.next(self._reports.rates)
        return {**health, "declared_hz": declared, "lost": lost, "waiting": waiting, "verdicts": verdicts}

    def _report(self) -> dict[str, Json]:
        errors: dict[str, Json] = {name: source.error or None for name, source in self._run.sources.items()}
        recorders: list[Json] = [name for name, sink in self._run.sinks.items() if sink.records]
        return {**self._health, "errors": errors, "recorders": recorders}

    async def _wait_for_recorders(self) -> None:
        """Wait up to 1 s until the recorders, which close concurrently, have written their queues."""
        recorders = [sink for sink in self._run.sinks.values() if sink.records]
        for _ in range(_POLLS if recorders and self._watched() else 0):
            before = [sink.rows for sink in recorders]
            await asyncio.sleep(_POLL)
            if before == [sink.rows for sink in recorders] and not any(sink.queued for sink in recorders):
                return

    async def _keep_reporting(self) -> None:
        while True:
            await asyncio.sleep(REPORT_EVERY)
            self._health = self._judged()
            if self._watched():
                self._messages.put("report", self._report())


class MessageBuffer:
    """Newest messages, numbered from 0, for clients that request those from a number on."""

    def __init__(self, limit: int = BUFFER_MAX) -> None:
        """Create a buffer of at most `limit` bytes; the oldest messages are dropped."""
        self.end = 0  # number of the next message
        self._limit, self._size = limit, 0
        self._messages: deque[bytes] = deque()
        self._added = asyncio.Event()

    def put(self, name: str, document: Json) -> None:
        """Add a message."""
        self._messages.append(encode([name, document]))
        self._size += len(self._messages[-1])
        self.end += 1
        while self._size > self._limit:
            self._size -= len(self._messages.popleft())
        self._added.set()
        self._added = asyncio.Event()

    async def since(self, number: int) -> list[bytes] | None:
        """Return the messages from `number` on, once there are any or after 1 s; None if some are dropped."""
        with suppress(TimeoutError):
            async with asyncio.timeout(REPORT_EVERY):
                while number == self.end:
                    await self._added.wait()
        first = self.end - len(self._messages)
        return [*self._messages][number - first :] if first <= number <= self.end else None


def _hello_messages(about: dict[str, Json], rows: Rows, origin: int, report: dict[str, Json]) -> list[bytes]:
    return [encode(["hello", {**about, **rows_json(rows, origin)}]), encode(["report", report])]
