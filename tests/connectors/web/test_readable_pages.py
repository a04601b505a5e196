"""The pages are readable in every state: contrast, size of text, edges, verdicts in words."""

import re

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect

from operators import FaultKind, Faults, Touch, Truth, ms
from operators.fingertip import Fingertip, grid
from operators.ports import Run, SinkStatus, SourceStatus
from tests.connectors.web.browsing import ServedPage, ServedRecording, Watched
from tests.connectors.web.reading import scored, slip
from tests.connectors.web.test_browser import a_minute
from tests.readability import faults

CELLS = 64


def unhealthy(served: ServedPage) -> None:
    """Keep a run in a state in which everything is wrong but the arm."""
    now = served.run.clock.now
    touch = SourceStatus(missing=60, declared_rate=100.0, up=True)
    motion = SourceStatus(declared_rate=100.0, up=True)
    rare = SourceStatus(rows=1, newest=now() - 1000 * ms, up=True)
    served.run.sources |= {"touch": touch, "motion": motion, "episodes": rare}

    def deliver() -> None:
        touch.rows, touch.newest = touch.rows + 3, now() - 1042 * ms
        motion.rows, motion.newest = motion.rows + 5, now()
        served.loop.call_later(0.05, deliver)

    served.loop.call_soon_threadsafe(deliver)
    served.run.sinks["mqtt"] = SinkStatus(rows=20_000, queued=3, waiting=12_345)


@pytest.mark.parametrize("slips", [False, True])
def test_every_tile_and_verdict_is_legible_on_a_desk_and_a_phone(browser: Browser, *, slips: bool) -> None:
    layout = grid(CELLS, 8)
    with ServedPage(fingertip=Fingertip(layout, 100.0, range=(0, 1008))) as served:
        unhealthy(served)

        def ready(tab: Page) -> None:
            now = served.run.clock.now()
            ramp = (np.arange(CELLS, dtype=np.int16) * 16)[None]  # from no to full pressure
            served.write(Touch(np.array([now]), ramp, ramp, ramp >= 0, finger=0), scored(now, 0.93))
            served.write(slip(now - 700 * ms, int(slips)))
            for cell, kind in ((5, FaultKind.DEAD), (63, FaultKind.SATURATED), (7, FaultKind.DRIFTING)):
                codes = np.array([cell], np.int8), np.array([kind], np.int8)
                served.write(Faults(np.array([now]), *codes, np.array([True]), finger=0))
            expect(tab.locator("#cells")).to_contain_text("barometer 63 saturated")
            expect(tab.locator("#sources")).to_contain_text("very late")
            row = tab.locator("#events tr").first
            expect(row).to_contain_text(re.compile("ms ■.very late"))
            expect(row).to_contain_text("slip onset" if slips else "slip end")
            expect(tab.locator(".pad td").nth(63)).to_contain_text("1008")
            tab.locator("details").evaluate("details => { details.open = true; }")

        assert faults(browser, served.url, ready) == []


def test_an_event_shows_a_quality_other_than_good_with_its_reason(watched: Watched) -> None:
    tab, rows = watched.tab, watched.tab.locator("#events tr")
    with ServedPage() as served:
        tab.goto(served.url)
        served.touch(-10)
        served.slip(1)
        expect(rows.first).to_contain_text("slip onset")
        expect(rows.first).not_to_contain_text("doubtful")
        codes = np.array([4], np.int8), np.array([FaultKind.DEAD], np.int8)
        served.write(Faults(np.array([0]), *codes, np.array([True]), finger=0))
        served.slip(1)
        expect(rows.first).to_contain_text("▲\u00a0doubtful: barometer 4 dead")
    assert watched.complaints == []


def test_health_is_judged_in_words(watched: Watched) -> None:
    tab = watched.tab
    with ServedPage() as served:
        unhealthy(served)
        tab.goto(served.url)
        served.touch(-10)
        rows = tab.locator("#sources tr")
        touch, motion = rows.filter(has_text="touch"), rows.filter(has_text="motion")
        expect(touch).to_contain_text("of 100 Hz")
        expect(touch).to_contain_text("ms ■ very late")
        expect(touch).to_contain_text("60 ■ losing")
        expect(motion).to_contain_text("● up")
        expect(motion).to_contain_text("0 ● good")
        expect(rows.filter(has_text="episodes")).to_contain_text("● up")
        queue = tab.locator("#sinks tr").filter(has_text="mqtt")
        expect(queue).to_contain_text("3 + 12,345 events ■ backlog")
        expect(tab.locator("#cells")).to_have_text("Fingertip 0● good")
        expect(tab.locator("#verdict")).to_contain_text(re.compile("■.[1-9] bad"))
        expect(tab.locator("#zone")).to_have_text(re.compile("UTC"))
    assert watched.complaints == []


def test_saturated_cells_are_marked_other_than_faulty_ones(watched: Watched) -> None:
    tab = watched.tab
    with ServedPage() as served:
        tab.goto(served.url)
        served.touch(-10)
        codes = np.array([2, 4], np.int8), np.array([FaultKind.SATURATED, FaultKind.DEAD], np.int8)
        at = np.array([0, 0])
        served.write(Faults(at, *codes, np.array([True, True]), finger=0))
        expect(tab.locator(".pad td.saturated")).to_contain_text("saturated")
        expect(tab.locator(".pad td.fault")).to_contain_text("dead")
        expect(tab.locator("#cells")).to_contain_text("■ barometer 2 saturated, barometer 4 dead")


def test_true_sliding_is_a_band_in_simulation(watched: Watched) -> None:
    tab = watched.tab
    colours = """canvas => {
      const { width, height } = canvas, data = canvas.getContext("2d").getImageData(0, 0, width, height).data;
      const found = new Set();
      for (let k = 0; k < data.length; k += 4) found.add(data.slice(k, k + 3).join());
      return found.has("106,79,179");
    }"""
    with ServedPage() as served:
        tab.goto(served.url)
        served.touch(-10)
        expect(tab.locator("#truth-key")).to_be_hidden()
        canvas = tab.locator("#scores canvas")
        assert not canvas.evaluate(colours)
        now = served.run.clock.now()
        time = now - np.arange(200)[::-1] * 10 * ms
        sliding = np.where(np.arange(200) < 100, 0.0, 0.01)
        served.write(Truth(time, sliding, sliding, np.zeros((200, 3)), finger=0))
        served.touch(-11)
        expect(tab.locator("#truth-key")).to_be_visible()
        tab.wait_for_timeout(300)
        assert canvas.evaluate(colours)


def test_the_page_that_asks_for_the_token_is_legible(browser: Browser) -> None:
    with ServedPage(token="0123456789abcdef") as served:  # noqa: S106 - of this test
        assert faults(browser, f"{served.url}/?token=wrong") == []


def test_the_page_of_a_recorded_session_is_legible(browser: Browser, run: Run) -> None:
    def ready(tab: Page) -> None:
        expect(tab.locator("#instant-text")).to_contain_text("UTC")
        expect(tab.locator(".count")).to_have_text(["41"] * 6)

    with ServedRecording(a_minute(run)) as served:
        assert faults(browser, served.url, ready) == []


def test_two_detectors_side_by_side_are_legible(browser: Browser, run: Run) -> None:
    def ready(tab: Page) -> None:
        for pane in tab.locator("iframe").all():
            expect(pane.content_frame.locator("#instant-text")).to_contain_text("UTC")
            expect(pane.content_frame.locator(".count")).to_have_text(["41"] * 6)

    with ServedRecording(a_minute(run), a_minute(run)) as served:
        assert faults(browser, served.url, ready) == []
