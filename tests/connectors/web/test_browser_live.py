"""The live page in a real browser: headless Chromium."""

import asyncio

import numpy as np
import pytest
from playwright.sync_api import ViewportSize, expect

from flows.cli.live_view import add_page
from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from flows.run.clocks import LoopClock
from flows.run.live_runner import LiveRunner
from operators import Debounce, FaultKind, Run, Score, Touch, Zero, Zeroed, ms
from operators.fingertip import TAKKTILE, Fingertip, grid
from storage import load_detector
from tests.connectors.web.browsing import Served, ServedPage, Watched, shaking, sideways
from tests.connectors.web.reading import fault, moved, scored

TOKEN = "0123456789abcdef"  # noqa: S105 - of tests


def test_a_running_flow_is_shown_and_a_slip_is_red(watched: Watched, monkeypatch: pytest.MonkeyPatch) -> None:
    tab, addresses = watched.tab, list[str]()
    monkeypatch.setattr("flows.cli.live_view.announce_page", lambda _, url, *__, **___: addresses.append(url))
    flow = Flow("pressed")
    zeroed = flow.source(TestSource(Touch, shaking(60), fingers=(0,))) | Zero()
    (zeroed | Score(load_detector("psd")) | Debounce()).to(TestSink())
    with Served() as served:
        add_page(flow, "127.0.0.1:0")

        async def begin() -> LiveRunner:
            return LiveRunner(flow, "session-7", clock=LoopClock())

        runner: LiveRunner = served.do(begin())
        running = asyncio.run_coroutine_threadsafe(runner.execute(), served.loop)
        while not addresses:
            served.do(asyncio.sleep(0))
        tab.goto(addresses[0])
        expect(tab.locator("#link")).to_have_text("Live")
        expect(tab.locator("#session")).to_have_text("Flow pressed · session session-7")
        state = tab.locator("#state")
        expect(state).to_have_attribute("data-slip", "true")
        expect(tab.locator("h1")).to_have_text("Fingertip 0Slip")
        expect(state).to_have_css("background-color", "rgb(195, 19, 27)")
        expect(state).to_have_attribute("data-slip", "false")
        expect(tab.locator("h1")).to_have_text("Fingertip 0No slip")
        expect(tab.locator("#events tr").first).to_contain_text("slip")
        expect(tab.locator("#events tr").first).to_contain_text(" ms")
        expect(tab.locator("#sources")).to_contain_text("Hz")
        expect(tab.locator("#recording")).to_have_text("Not recording")
        served.loop.call_soon_threadsafe(runner.stop)
        run: Run = running.result(30)
        expect(tab.locator("#link")).to_have_text("Ended")
    assert run.sinks["page"].dropped == 0
    assert {url.split("/")[2] for url in watched.asked} == {addresses[0].split("/")[2]}


@pytest.mark.parametrize("width", [390, 1280])
def test_every_part_is_shown_and_nothing_is_cut_off_at_the_side(watched: Watched, width: int) -> None:
    tab, cells = watched.tab, 64
    tab.set_viewport_size(ViewportSize(width=width, height=844))
    layout = tuple(row[::-1] for row in grid(cells, 8))  # numbered from the top right
    tip = Fingertip(layout, 1000.0, "kPa", 0.01, (0, 4000))
    name = "a-session-with-a-really-long-name-20261121T185903.123456Z"
    with ServedPage(session=name, fingertip=tip, kind=Touch) as served:
        tab.goto(served.url)
        now = served.run.clock.now()
        counts = np.arange(100, 100 + cells, dtype=np.int16)[None]
        served.write(Touch(np.array([now]), counts, counts, counts > 0, finger=0))
        expect(tab.locator("h1")).to_have_text("Fingertip 0Unknown")
        expect(tab.locator("#motion")).to_be_hidden()
        served.write(scored(now, 0.93), moved(now))
        served.write(fault(now, 5, FaultKind.STUCK), fault(now, 63, FaultKind.SATURATED))
        served.slip(1)
        expect(tab.locator("#events tr")).to_contain_text("slip onset▲\u00a0doubtful: barometer 5 stuck")
        expect(tab.locator("#cells")).to_contain_text("■ barometer 5 stuck, barometer 63 saturated")
        expect(tab.locator("#quality")).to_have_text("Doubtful: barometer 5 stuck")
        expect(tab.locator(".pad tr").first.locator(".which")).to_have_text(list(map(str, layout[0])))
        expect(tab.locator(".count").first).to_have_text("1.07")
        expect(tab.locator(".pad td.fault")).to_contain_text("stuck")
        expect(tab.locator(".pad td.saturated")).to_contain_text("max")
        expect(tab.locator("#unit")).to_have_text("Raw kPa, which rise with pressure.")
        expect(tab.locator("#ramp-to")).to_have_text("40.00")
        expect(tab.locator("#probability")).to_have_text("0.93")
        expect(tab.locator("#speed")).to_have_text("3.0")
        expect(tab.locator("#sources")).to_contain_text("down: 10.0.0.2: unplugged")
        expect(tab.locator("#recording")).to_have_text("Recording, 1,234 rows")
        expect(tab.locator("[aria-live=polite]")).to_have_text("slip onset: fingertip 0")
        expect(tab).to_have_title("Slip · Fingertip 0 · demo · slipflow")
        for name in ("Reading of each barometer", "Slip probability", "TCP speed"):
            expect(tab.get_by_role("img", name=name)).to_be_visible()
        for scheme in ("light", "dark"):
            tab.emulate_media(color_scheme=scheme)
            assert sideways(tab) == 0


@pytest.mark.parametrize("cells", [1, 6, 16, 64])
def test_each_curve_has_its_own_look_and_its_tile_highlights_it(watched: Watched, cells: int) -> None:
    tab, tip = watched.tab, TAKKTILE if cells == 6 else Fingertip(grid(cells), 100.0, "kPa", 0.01, (0, 4000))
    look = "key => getComputedStyle(key).color + key.classList"
    fits = "tile => [...tile.children].every((each) => each.offsetWidth < tile.offsetWidth)"
    with ServedPage(fingertip=tip) as served:
        tab.goto(served.url)
        now, sign = served.run.clock.now(), -1 if tip is TAKKTILE else 1
        counts, time = np.tile(np.arange(1, cells + 1, dtype=np.int16), (9, 1)), now + np.arange(9) * 10 * ms
        for finger in range(3):
            served.write(Zeroed(time, sign * counts, counts, counts > 0, finger=finger))
            served.write(scored(now, 0.1, finger))
        keys, pad = tab.locator(".key"), tab.locator(".pad").first
        expect(keys).to_have_count(3 * cells)
        order = [cell for row in tip.layout for cell in row]
        expect(pad.locator(".which")).to_have_text([str(cell) for cell in order])
        amounts = [f"{(cell + 1) * tip.resolution:.{0 if tip is TAKKTILE else 2}f}" for cell in order]
        expect(pad.locator(".count")).to_have_text(amounts)
        number, amount = (pad.locator(name).last.bounding_box() for name in (".which", ".count"))
        assert number
        assert amount
        assert amount["y"] >= number["y"] + number["height"] / 2, "they do not cover each other"
        for scheme in ("light", "dark"):
            tab.emulate_media(color_scheme=scheme)
            assert len({keys.nth(k).evaluate(look) for k in range(cells)}) == cells
        chart, unit = tab.locator("#counts"), tab.locator("#counts-unit")
        plain, tile = chart.screenshot(), pad.locator("td").last
        tile.hover()
        expect(unit).to_contain_text(f"barometer {tile.get_attribute('data-cell')} highlighted")
        assert cells == 1 or chart.screenshot() != plain
        tab.mouse.move(0, 0)
        expect(unit).not_to_contain_text("highlighted")
        tile.click()  # as with a finger
        tab.mouse.move(0, 0)
        expect(tab.locator("td.marked")).to_have_count(3)
        expect(unit).to_contain_text("highlighted")
        assert tab.locator("body").inner_text().count("good") == 1
        served.write(fault(now, cells - 1, FaultKind.SATURATED))
        expect(pad.locator(".saturated")).to_contain_text("max")
        assert pad.locator(".saturated").evaluate(fits)


def test_the_page_reconnects_to_a_restarted_server_unless_that_has_another_token(watched: Watched) -> None:
    tab = watched.tab
    with ServedPage() as first:
        port = int(first.url.rpartition(":")[2])
        tab.goto(first.url)
        first.touch(-5)
        expect(tab.locator("#session")).to_have_text("Flow demo · session first")
        assert watched.complaints == []
    expect(tab.locator("#link")).to_have_text("Ended")
    tab.locator(".pad td").first.click()
    expect(tab.locator("h1")).to_have_text("Fingertip 0Ended")
    expect(tab.locator("#notice")).to_contain_text("waits for the next run")
    with ServedPage(port, "second") as second:
        second.touch(-77)
        expect(tab.locator("#session")).to_have_text("Flow demo · session second")
        expect(tab.locator("#link")).to_have_text("Live")
        expect(tab.locator("#notice")).to_be_hidden()
        expect(tab.locator(".count").first).to_have_text("77")
    assert all("ERR_" in complaint for complaint in watched.complaints)  # while no server ran
    with ServedPage(port, token=TOKEN) as third:
        expect(tab.get_by_text("Access to the page needs its token")).to_be_visible()
        tab.goto(third.page.login_url)
        third.touch(-33)
        expect(tab.locator(".count").first).to_have_text("33")
    watched.complaints.clear()


def test_every_control_works_with_the_keyboard(watched: Watched) -> None:
    tab = watched.tab
    with ServedPage() as served:
        tab.goto(served.url)
        served.touch(-10, finger=0)
        served.touch(-20, finger=1)
        served.slip(1, finger=1)
        expect(tab.get_by_role("radio")).to_have_count(2)
        tab.keyboard.press("Tab")
        expect(tab.get_by_role("combobox", name="Window")).to_be_focused()
        tab.keyboard.press("ArrowDown")
        expect(tab.get_by_role("combobox")).to_have_value("30")
        tab.keyboard.press("Tab")
        expect(tab.get_by_role("button", name="Pause")).to_be_focused()
        tab.keyboard.press("Tab")
        expect(tab.get_by_role("radio", name="Fingertip 0")).to_be_focused()
        expect(tab.locator("#state")).to_have_attribute("data-slip", "false")
        tab.keyboard.press("ArrowDown")
        expect(tab.get_by_role("radio", name="Fingertip 1")).to_be_checked()
        expect(tab.locator("h1")).to_have_text("Fingertip 1Slip")
        tab.keyboard.press("Shift+Tab")
        tab.keyboard.press("ArrowRight")
        tab.keyboard.press("ArrowRight")
        expect(tab.locator("#counts-unit")).to_contain_text("barometer 4 highlighted")
        tab.keyboard.press("Escape")
        expect(tab.locator("#counts-unit")).not_to_contain_text("highlighted")
        tab.keyboard.press("Shift+Tab")
        tab.keyboard.press("Enter")
        expect(tab.get_by_role("button", name="Resume")).to_have_attribute("aria-pressed", "true")
        served.touch(-99, finger=1)
        served.slip(0, finger=1)
        expect(tab.locator("h1")).to_have_text("Fingertip 1No slip")  # also updated during a pause
        expect(tab.locator(".count").nth(6)).to_have_text("20")
        tab.keyboard.press("Enter")
        expect(tab.locator(".count").nth(6)).to_have_text("99")
