"""Sink that serves a live page of a running flow, and the frames that its browsers request.

A frame is a JSON object. Times are ms since the start of the run; fingertips have the names used in events:

- ``now``: time of the run's clock when the frame was made
- ``rows``: by stream and fingertip, such as ``touch 0``, ``t`` (n,) and ``v``: (n, cells) counts of
  ``touch``, null for invalid cells; (n,) probability of ``scores``; (n,) TCP speed of ``speed``, mm/s
- ``events``: numbered onsets and ends of slip with their quality; ``latency``: ms from the deciding sample to
  its arrival here, null in a replay
- ``slipping``: fingertips that slip now; ``faults``: kind of fault, by fingertip and barometer
- ``quality``: quality of the newest score and its reason, by fingertip
"""

import asyncio
from collections import defaultdict, deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from itertools import takewhile
from typing import TYPE_CHECKING, Final, NamedTuple

from connectors.events import Fault, encode, faults, finger_name, quality, slips
from connectors.web.access import PAGE_PORT, http_url, required_token
from connectors.web.curves import curve_json, event_json, faults_json, join_rows, plotted, thin_curve
from operators.batch import Faults, Motion, Reals, Scores, Slips, Times, Touch, Zeroed, ms, s
from operators.checks import check_between
from operators.extras import software_version
from operators.ports import Json, Run, Sink

if TYPE_CHECKING:
    from aiohttp.web import Request, Response, WebSocketResponse

FRAME_EVERY: Final = 0.025  # s, shortest time between frames
REPORT_EVERY: Final = 1.0  # s
END_WITHIN: Final = 0.5  # s, until all browsers have received the end of the run
SILENCE: Final = 20.0  # s without a request of a browser until its connection is closed
_MESSAGE_MAX: Final = 1024  # bytes of a request
EVENTS_KEPT: Final = 100
KEPT: Final = 30 * s  # ns of each stream
BATCHES_KEPT: Final = 100_000  # also if stamps are wrong
STEP: Final = 5 * ms  # ns; more than two rows per step are reduced to their extremes


class Rows(NamedTuple):
    """Rows of a batch, which do not change."""

    number: int  # of the batch
    curve: str
    time: Times
    values: Reals


class Page(Sink[Touch | Motion | Scores | Slips | Faults]):
    """Live page in the browser: pressure maps, slip probability, TCP speed, slip events with latency, health.

    Connect each stream to show: touch (raw touch is ignored if there is zeroed touch, too), motion, scores,
    slips and faults. The health covers all sources and sinks of the run.

    The page may drop rows and never slows the run. A slow browser gets fewer frames, at most 40 per second.

    Only this machine can reach the page unless `host` is set, which requires SLIPFLOW_PAGE_TOKEN. The
    connection is not encrypted: outside a trusted network, use a TLS proxy that keeps the header Host.

    Args:
        port: Port to listen on; 0 for any free port; None for 8765, or any free port if that is in use.
        host: Address of this machine to listen on, 0.0.0.0 for all.
        threshold: Probability from which a sample counts as slip, marked on the page; None: no mark.
        opened: Called with the URL once the page is open.

    Raises:
        ParameterError: if `port` or `threshold` is out of range; if the token is malformed, or missing
            although other machines can reach `host`.
    """

    lossless = False

    def __init__(
        self,
        port: int | None = None,
        host: str = "127.0.0.1",
        *,
        threshold: float | None = None,
        opened: Callable[[str], None] = lambda url: None,
    ) -> None:
        if port is not None:
            check_between("Page", "port", port, 0, 65535)
        if threshold is not None:
            check_between("Page", "threshold", threshold, 0, 1)
        required_token("Page", host)
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
        """
        from aiohttp import web

        from connectors.web.web_server import PAGE_FILES, page_server

        self._zeroed = any(issubclass(kind, Zeroed) for kind in run.sink_types.get(self.destination, ()))
        self._run, self._frames = run, Frames(run, zeroed=self._zeroed)
        self._ended, self._browsers = False, set[asyncio.Task[object]]()
        self._server = page_server(self._host, self._port)

        async def about(request: "Request") -> "Response":
            return web.json_response({"mode": "live"})

        async def live(request: "Request") -> "WebSocketResponse":
            socket = web.WebSocketResponse(receive_timeout=SILENCE, compress=False, max_msg_size=_MESSAGE_MAX)
            await socket.prepare(request)
            task = asyncio.current_task()
            assert task, "a request is handled by a task"
            self._browsers.add(task)
            task.add_done_callback(self._browsers.discard)
            with suppress(TimeoutError):  # the browser is gone
                await self._follow(socket)
            return socket

        await self._server.open(*PAGE_FILES, web.get("/about.json", about), web.get("/live", live))
        self._opened(self.url)

    def take(self, batch: Touch | Motion | Scores | Slips | Faults) -> bool:
        """Add the rows of a batch to the next frame."""
        self._frames.add(batch)
        return True

    async def close(self) -> None:
        """Send the end of the run to browsers that ask within 0.5 s, and stop serving."""
        self._ended = True
        if self._browsers:  # once the server closes, it receives nothing
            await asyncio.wait(self._browsers, timeout=END_WITHIN)
        await self._server.close()

    async def _follow(self, socket: "WebSocketResponse") -> None:
        """Answer each request of a browser with what is new for it, until it leaves or the run ends."""
        frames, clock = self._frames, asyncio.get_running_loop().time
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
                frame["report"] = self._health()
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
        known = run.fingertips.get(self.destination, {}).values()
        return {
            "version": software_version(),
            "session": run.session,
            "flow": run.flow,
            "recording": run.recording,
            "start": run.start / ms,
            "threshold": self.threshold,
            "fingertip": next((each.describe() for each in known), None),
            "zeroed": self._zeroed,
        }

    def _health(self) -> dict[str, Json]:
        """Return the state of all sources and sinks, with their error texts."""
        sources: dict[str, Json] = {
            name: {**vars(each), "gaps": len(each.gaps), "lost": each.lost, "newest": each.newest / ms}
            for name, each in self._run.sources.items()
        }
        return {"sources": sources, "sinks": {name: vars(each) for name, each in self._run.sinks.items()}}


class Frames:
    """Collector of the rows and events of a run, with bounded memory."""

    def __init__(self, run: Run, *, zeroed: bool) -> None:
        self._run, self._zeroed = run, zeroed  # True: touch that is not zeroed is ignored
        self.count = 0  # of batches
        self._rows: deque[Rows] = deque(maxlen=BATCHES_KEPT)
        self._scores: dict[str, float] = {}  # newest probability by fingertip
        self._slipping: set[str] = set()
        self._faults: dict[str, set[Fault]] = {}  # active, by fingertip
        self._events: deque[tuple[int, dict[str, Json]]] = deque(maxlen=EVENTS_KEPT)  # number of the batch
        self._numbered = 0  # number of the newest event

    def add(self, batch: Touch | Motion | Scores | Slips | Faults) -> None:
        """Add a batch."""
        self.count += 1
        finger = finger_name(batch.finger)
        active = self._faults.setdefault(finger, set())
        if isinstance(batch, Slips):
            for slip in slips(batch):
                (self._slipping.add if slip.onset else self._slipping.discard)(finger)
                self._numbered += 1
                latency = self._run.latency(slip.time)
                event = event_json(
                    self._numbered, finger, slip, self._run.start, latency=latency, faults=active
                )
                self._events.append((self.count, event))
        elif isinstance(batch, Faults):
            for _, fault, begins in faults(batch):
                (active.add if begins else active.discard)(fault)
        elif len(batch) and (not isinstance(batch, Touch) or isinstance(batch, Zeroed) or not self._zeroed):
            oldest = batch.time.item(-1) - KEPT
            kept = batch[int(batch.time.searchsorted(oldest)) :]
            curve, values = plotted(kept)
            self._rows.append(Rows(self.count, curve, kept.time, values))
            while self._rows[0].time[-1] < oldest:
                self._rows.popleft()
            if isinstance(batch, Scores):
                self._scores[finger] = batch.probability.item(-1)

    def since(self, seen: int) -> tuple[list[Rows], dict[str, Json]]:
        """Return what came after the first `seen` batches: rows, and all else as JSON."""
        rows = [*takewhile(lambda each: each.number > seen, reversed(self._rows))]
        return rows[::-1], {
            "now": (self._run.clock.now() - self._run.start) / ms,
            "events": [event for number, event in self._events if number > seen],
            "slipping": sorted(self._slipping),
            "faults": faults_json(self._faults),
            "quality": {
                finger: quality(probability, self._faults[finger])
                for finger, probability in self._scores.items()
            },
        }


def rows_json(rows: Iterable[Rows], origin: int) -> dict[str, Json]:
    """Return rows by curve as JSON, with times since `origin` (ns)."""
    curves = defaultdict[str, list[Rows]](list)
    for each in rows:
        curves[each.curve].append(each)
    found: dict[str, Json] = {}
    for name, parts in curves.items():
        time, values = join_rows((each.time, each.values) for each in parts)
        begin, end = time.item(0), time.item(-1)
        thin = thin_curve(time, values, begin, end, 1 + (end - begin) // STEP)
        found[name] = curve_json(*thin, origin)
    return found
