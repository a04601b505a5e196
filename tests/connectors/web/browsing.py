"""Pages in a thread, for browser tests."""

import asyncio
from collections.abc import Coroutine, Generator
from contextlib import contextmanager
from threading import Thread
from typing import Any, Self

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Locator, Request, sync_playwright
from playwright.sync_api import Page as Tab

from connectors import Page
from connectors.web.access import TOKEN
from connectors.web.session_page import SessionPage
from connectors.web.web_server import page_server
from flows.run.clocks import LoopClock
from operators.batch import Batch, Faults, Motion, Scores, Slips, Touch, Zeroed, ms
from operators.fingertip import TAKKTILE, Fingertip
from operators.ports import Run, SinkStatus, SourceStatus
from tests.connectors.web.reading import slip, touched
from tests.waiting import PATIENCE

WIDTH_OF_AXIS, RIGHT = 52, 10  # px, as in charts.js
LATE = 60_000  # ms, for a busy machine
MOVE = """(slider, t) => {
  slider.step = 10;  // finer than by hand
  slider.value = t;
  slider.dispatchEvent(new Event("input"));
}"""


@contextmanager
def chromium() -> Generator[Browser]:
    """Start headless Chromium."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        yield browser
        browser.close()


class Watched:
    """A tab with its errors, warnings and requests."""

    def __init__(self, tab: Tab) -> None:
        self.tab = tab
        self.complaints: list[str] = []
        self.asked: list[str] = []
        tab.set_default_timeout(LATE)
        tab.on("console", self._complained)
        tab.on("pageerror", lambda error: self.complaints.append(str(error)))
        tab.on("request", self._requested)

    def _complained(self, message: ConsoleMessage) -> None:
        if message.type in ("error", "warning"):
            self.complaints.append(f"{message.text} {message.location.get('url')}")

    def _requested(self, request: Request) -> None:
        self.asked.append(request.url)


def shaking(seconds: int) -> list[Touch]:
    """Batches of one row: still for 2 s, then pressed and shaken for each other second."""
    batches = list[Touch]()
    for k in range(seconds * 100):
        shaken = k > 200 and k // 100 % 2 == 0
        count = 700 - (250 + 200 * (k % 3) if shaken else k % 2)
        batches.append(Touch.rows([k * 10 * ms], [[count] * 6], count, True, finger=0))
    return batches


def sideways(tab: Tab) -> int:
    """Return by how many pixels the page can be scrolled sideways."""
    found: int = tab.evaluate("() => document.documentElement.scrollWidth - innerWidth")
    return found


def drag(tab: Tab, place: Locator, begin: float, end: float, *, y: float = 0.5) -> None:
    """Drag over a chart, from and to shares of its time axis."""
    place.scroll_into_view_if_needed()
    box = place.bounding_box()
    assert box is not None
    wide = box["width"] - WIDTH_OF_AXIS - RIGHT
    at = [box["x"] + WIDTH_OF_AXIS + share * wide for share in (begin, end)]
    tab.mouse.move(at[0], box["y"] + y * box["height"])
    tab.mouse.down()
    tab.mouse.move(at[1], box["y"] + y * box["height"], steps=5)
    tab.mouse.up()


class Served:
    """An event loop in a thread, with a page in it."""

    def __init__(self) -> None:
        self.loop = asyncio.new_event_loop()
        self._thread = Thread(target=self.loop.run_forever)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join()
        self.loop.close()

    def do(self, coroutine: Coroutine[Any, Any, Any]) -> Any:
        """Run a coroutine in the loop and return its result."""
        return asyncio.run_coroutine_threadsafe(coroutine, self.loop).result(PATIENCE)


class ServedPage(Served):
    """A live page of a run whose rows the test gives."""

    def __init__(
        self,
        port: int = 0,
        session: str = "first",
        token: str = "",
        fingertip: Fingertip = TAKKTILE,
        kind: type[Touch] = Zeroed,
    ) -> None:
        super().__init__()
        self._port, self._session, self._token = port, session, token
        self._touch: dict[type[Batch], Fingertip] = {kind: fingertip}

    def __enter__(self) -> Self:
        super().__enter__()
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv(TOKEN, self._token)
            self.do(self._open())
        return self

    def __exit__(self, *_: object) -> None:
        self.do(self.page.close())
        super().__exit__()

    async def _open(self) -> None:
        self.page, clock = Page(self._port, threshold=0.78), LoopClock()
        self.run = run = Run(self._session, "demo", clock, clock.now())
        run.sources["touch"] = SourceStatus(rows=100, newest=clock.now(), up=True)
        run.sources["motion"] = SourceStatus(error="10.0.0.2: unplugged")
        run.sinks["dataset"] = SinkStatus(rows=1234, records=True)
        run.fingertips = {self.page.destination: self._touch}
        run.sink_types = {self.page.destination: dict.fromkeys(self._touch, (0,))}
        await self.page.open(run)

    @property
    def url(self) -> str:
        """Address of the page."""
        return self.page.url

    def write(self, *batches: Touch | Motion | Scores | Slips | Faults) -> None:
        """Write rows."""
        for batch in batches:
            self.do(self.page.write(batch))

    def touch(self, *counts: int, finger: int = 0) -> None:
        """Write a touch row with the time of now."""
        self.write(touched(self.run.clock.now(), *counts, finger=finger))

    def slip(self, state: int, finger: int = 0) -> None:
        """Write an onset (1) or an end (0), decided 5 ms ago."""
        self.write(slip(self.run.clock.now() - 5 * ms, state, finger=finger))


class ServedRecording(Served):
    """The page of a recorded session."""

    def __init__(self, recorded: Coroutine[Any, Any, SessionPage]) -> None:
        super().__init__()
        self._recorded = recorded

    def __enter__(self) -> Self:
        super().__enter__()
        self._server = page_server("127.0.0.1", 0)
        self.page: SessionPage = self.do(self._recorded)
        self.do(self._server.open(*self.page.routes))
        self.url = self._server.url
        return self

    def __exit__(self, *_: object) -> None:
        self.do(self._server.close())
        super().__exit__()
