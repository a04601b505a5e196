"""The page in a real browser: headless Chromium."""

import asyncio
import re

import numpy as np
import pytest
from playwright.sync_api import ViewportSize, expect

from connectors.web.session_page import SessionCurves
from connectors.web.session_requests import SessionPage
from flows.cli.live_view import add_page
from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from flows.run.clocks import LoopClock
from flows.run.live_runner import LiveRunner
from operators import Debounce, FaultKind, Faults, Run, Score, Scores, Slips, Touch, Zero, Zeroed, ms, s
from operators.fingertip import Fingertip, grid
from storage import load_detector
from tests.connectors.web.browsing import Served, ServedPage, ServedRecording, Watched, shaking
from tests.connectors.web.reading import moved, scored, slip, touched

MOVE = """(slider, t) => {
  slider.step = 10;  // finer than by hand
  slider.value = t;
  slider.dispatchEvent(new Event("input"));
}"""


def test_a_running_flow_is_shown_and_a_slip_turns_the_page_red(watched: Watched) -> None:
    tab, addresses = watched.tab, list[str]()
    flow = Flow("pressed")
    zeroed = flow.source(TestSource(Touch, shaking(60), fingers=(0,))) | Zero()
    (zeroed | Score(load_detector("psd")) | Debounce()).to(TestSink())
    with Served() as served:
        add_page(flow, "127.0.0.1:0", opened=addresses.append)

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
        expect(tab.locator("#recording")).to_have_text("Not recorded")
    assert run.sinks["page"].dropped == 0
    assert watched.complaints == []
    assert {url.split("/")[2] for url in watched.asked} == {addresses[0].split("/")[2]}


@pytest.mark.parametrize("cells", [16, 64])
def test_a_fingertip_of_many_cells_has_a_tile_for_each_in_its_layout(watched: Watched, cells: int) -> None:
    tab, wide = watched.tab, int(cells**0.5)
    layout = tuple(row[::-1] for row in grid(cells, wide))  # numbered from the top right
    with ServedPage(fingertip=Fingertip(layout, 1000.0, "kPa", 0.01, (0, 4000))) as served:
        tab.goto(served.url)
        now = served.run.clock.now()
        counts = np.arange(100, 100 + cells, dtype=np.int16)[None]
        served.write(Touch(np.array([now]), counts, counts, counts > 0, finger=0))
        expect(tab.locator(".pad td")).to_have_count(cells)
        expect(tab.locator(".pad tr")).to_have_count(wide)
        expect(tab.locator(".pad tr").first.locator(".which")).to_have_text(list(map(str, layout[0])))
        expect(tab.locator(".count").first).to_have_text(f"1.0{wide - 1}")
        expect(tab.locator("#unit")).to_have_text("Raw kPa, which rise with pressure.")
        expect(tab.locator("#ramp-to")).to_have_text("40.00")
        box = tab.locator(".pad td").last.bounding_box()
        assert box is not None
        assert box["x"] + box["width"] <= 1280
    assert watched.complaints == []


def test_the_page_reconnects_to_a_restarted_server(watched: Watched) -> None:
    tab = watched.tab
    with ServedPage() as first:
        port = int(first.url.rpartition(":")[2])
        tab.goto(first.url)
        first.touch(-5)
        expect(tab.locator("#session")).to_have_text("Flow demo · session first")
        assert watched.complaints == []
    expect(tab.locator("#link")).to_have_text("Ended")
    expect(tab.locator("#recording")).to_have_text("Recorded, 1,234 rows")
    expect(tab.locator("#notice")).to_contain_text("waits for the next run")
    with ServedPage(port, "second") as second:
        second.touch(-77)
        expect(tab.locator("#session")).to_have_text("Flow demo · session second")
        expect(tab.locator("#link")).to_have_text("Live")
        expect(tab.locator("#notice")).to_be_hidden()
        expect(tab.locator(".count").first).to_have_text("77")
    assert all("ERR_" in complaint for complaint in watched.complaints)  # while no server ran


def test_a_server_restarted_with_another_token_asks_for_it(watched: Watched) -> None:
    tab, one, other = watched.tab, "0123456789abcdef", "fedcba9876543210"
    with ServedPage(token=one) as first:
        port = int(first.url.rpartition(":")[2])
        tab.goto(first.page.login_url)
        first.touch(-5)
        expect(tab.locator("#link")).to_have_text("Live")
    with ServedPage(port, token=other) as second:
        expect(tab.get_by_role("heading", name="Token required")).to_be_visible()
        tab.goto(second.page.login_url)
        second.touch(-77)
        expect(tab.locator(".count").first).to_have_text("77")


def test_maps_have_the_layout_of_the_sensor_and_show_faults(watched: Watched) -> None:
    with ServedPage() as served:
        watched.tab.goto(served.url)
        served.touch(-10, -11, -12, -13, -14, -15)
        served.write(
            Faults(np.array([0]), np.array([3], np.int8), np.array([1], np.int8), np.array([True]), finger=0)
        )
        cells = watched.tab.locator(".pad td")
        expect(cells.nth(2)).to_contain_text("stuck")
        expect(watched.tab.locator(".pad .count")).to_have_text(["15", "14", "13", "10", "11", "12"])
        expect(watched.tab.locator(".pad .which")).to_have_text(["5", "4", "3", "0", "1", "2"])
        shares = [
            float(cells.nth(k).evaluate("cell => cell.style.getPropertyValue('--share')")) for k in (0, 3)
        ]
        assert shares == pytest.approx([0.15, 0.1])
        expect(watched.tab.locator("#sources")).to_contain_text("down: 10.0.0.2: unplugged")
        expect(watched.tab.locator("#recording")).to_have_text("Recording, 1,234 rows")


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
        tab.keyboard.press("Enter")
        expect(tab.get_by_role("button", name="Resume")).to_have_attribute("aria-pressed", "true")
        served.touch(-99, finger=1)
        served.slip(0, finger=1)
        expect(tab.locator("h1")).to_have_text("Fingertip 1No slip")  # also updated during a pause
        expect(tab.locator(".count").nth(6)).to_have_text("20")
        tab.keyboard.press("Enter")
        expect(tab.locator(".count").nth(6)).to_have_text("99")


def test_a_slip_is_announced_and_shown_in_the_title(watched: Watched) -> None:
    tab = watched.tab
    with ServedPage() as served:
        tab.goto(served.url)
        expect(tab).to_have_title("demo · slipflow")  # before the first sample
        served.touch(-10)
        served.write(moved(served.run.clock.now()))
        expect(tab).to_have_title("Unknown · Fingertip 0 · demo · slipflow")
        served.write(scored(served.run.start, 0.1))
        expect(tab).to_have_title("No slip · Fingertip 0 · demo · slipflow")
        served.slip(1)
        expect(tab.locator("[aria-live=polite]")).to_have_text("slip onset: fingertip 0")
        expect(tab).to_have_title("Slip · Fingertip 0 · demo · slipflow")
        for name in ("Pressure of each barometer", "Slip probability", "TCP speed"):
            expect(tab.get_by_role("img", name=name)).to_be_visible()
        expect(tab.get_by_role("table", name="Pressure of fingertip 0")).to_be_visible()


def test_the_quality_of_the_newest_score_is_shown(watched: Watched) -> None:
    tab = watched.tab
    with ServedPage() as served:
        tab.goto(served.url)
        served.touch(-40)
        served.write(scored(served.run.clock.now(), 0.9))
        expect(tab.locator("#quality")).to_have_text("Quality: good")
        codes = np.array([4], np.int8), np.array([FaultKind.DEAD], np.int8)
        served.write(Faults(np.array([0]), *codes, np.array([True]), finger=0))
        served.touch(-90)
        served.write(scored(served.run.clock.now(), 0.9))
        expect(tab.locator("#quality")).to_have_text("Doubtful: barometer 4 dead")
    assert watched.complaints == []


def test_without_motion_the_speed_chart_is_hidden(watched: Watched) -> None:
    tab = watched.tab
    with ServedPage() as served:
        tab.goto(served.url)
        served.touch(-10)
        expect(tab.locator(".count").first).to_have_text("10")
        chart, speed = tab.locator("#motion"), tab.locator("#speed")
        expect(chart).to_be_hidden()
        expect(speed).to_be_hidden()
        served.write(moved(served.run.clock.now()))
        served.touch(-11)
        expect(chart).to_be_visible()
        expect(speed).to_have_text("3.0")
    assert watched.complaints == []


def test_a_tile_keeps_its_height_in_every_state(watched: Watched) -> None:
    tab = watched.tab
    with ServedPage() as served:
        tab.goto(served.url)
        for finger in (0, 12):
            served.touch(-10, finger=finger)
        tile, said = tab.locator(".finger").last, tab.locator(".finger .now").last
        heights = set[float]()
        expect(said).to_have_text("\u2013")
        heights.add(tile.evaluate("tile => tile.offsetHeight"))
        for state, text in ((1, "slip"), (0, "no slip")):
            served.slip(state, finger=12)
            expect(said).to_have_text(text)
            heights.add(tile.evaluate("tile => tile.offsetHeight"))
            assert tile.evaluate(
                "tile => [...tile.querySelectorAll('b, .who')].every(n => n.scrollWidth <= n.clientWidth)"
            )
        assert len(heights) == 1


@pytest.mark.parametrize("width", [320, 390, 1024])
def test_nothing_is_cut_off_at_the_side(watched: Watched, width: int) -> None:
    tab = watched.tab
    tab.set_viewport_size(ViewportSize(width=width, height=844))
    with ServedPage(session="a-session-with-a-name-that-is-really-long-20261121T185903.123456Z") as served:
        tab.goto(served.url)
        served.touch(-500)
        served.slip(1)
        expect(tab.locator("#events tr")).to_have_count(1)
        assert tab.evaluate("() => document.documentElement.scrollWidth") == width


def test_the_token_can_be_entered_on_the_page(watched: Watched) -> None:
    token, tab = "0123456789abcdef", watched.tab
    with ServedPage(token=token) as served:
        tab.goto(served.url)
        expect(tab.get_by_role("heading", name="Token required")).to_be_visible()
        expect(tab.locator("body")).to_have_css("background-color", "rgb(239, 241, 242)")  # as on the pages
        expect(tab.get_by_text("Wrong token.")).to_be_hidden()
        field = tab.get_by_label("Token", exact=True)
        expect(field).to_be_focused()
        field.fill("no token at all")
        tab.keyboard.press("Enter")
        expect(tab.get_by_text("Wrong token.")).to_be_visible()
        refused = "the server responded with a status of 401"
        assert [text for text in watched.complaints if refused not in text] == []
        watched.complaints.clear()
        field.fill(token)
        tab.get_by_role("button", name="Open").click()
        served.touch(-10)
        expect(tab.locator("#link")).to_have_text("Live")
        assert tab.url == f"{served.url}/"
        assert watched.complaints == []


def test_a_token_in_the_url_opens_the_page_and_is_removed_from_the_url(watched: Watched) -> None:
    with ServedPage(token="0123456789abcdef") as served:  # noqa: S106 - of this test
        watched.tab.goto(served.page.login_url)
        served.touch(-10)
        expect(watched.tab.locator("#link")).to_have_text("Live")
        assert watched.tab.url == f"{served.url}/"
        assert watched.complaints == []


async def a_minute(run: Run) -> SessionPage:
    """Return a recording of a minute: the counts are the second; slip from the 40th to the 42nd."""
    recorded = SessionCurves(rule=Debounce(0.78), about="A recorded session.", flow="record", dataset="lab")
    await recorded.open(run)
    for k in range(6000):
        await recorded.write(touched(run.start + k * 10 * ms, -(k // 100)))
        if k >= 500:
            await recorded.write(scored(run.start + k * 10 * ms, 0.1))
    await recorded.write(slip(run.start + 40 * s, 1))
    await recorded.write(slip(run.start + 42 * s, 0))
    await recorded.close()
    return SessionPage(recorded)


def test_a_recorded_session_is_scrubbed_by_slider_keys_and_events(watched: Watched, run: Run) -> None:
    tab = watched.tab
    with ServedRecording(a_minute(run)) as served:
        tab.goto(served.url)
        expect(tab.locator("#session")).to_have_text("Flow record · dataset lab · session run1")
        expect(tab).to_have_title("Slip · Fingertip 0 · run1 · slipflow")
        expect(tab.locator("#events-count")).to_have_text("1 slip")
        slider, count = tab.get_by_role("slider", name="Time in the session"), tab.locator(".count").first
        expect(tab.locator("#instant-text")).to_contain_text("0:41.0")  # a second into the first slip
        expect(tab.locator("h1")).to_have_text("Fingertip 0Slip")
        expect(slider).to_have_attribute("aria-valuetext", "0:41.0, slip")
        slider.press("Home")
        expect(slider).to_have_attribute("aria-valuetext", "0:00.0")
        expect(tab.locator("h1")).to_have_text("Fingertip 0Unknown")  # before the first score
        expect(count).to_have_text("0")
        with tab.expect_request(lambda request: "window?begin=0&end=59990&at=0&" in request.url):
            tab.get_by_role("combobox", name="Window").select_option(label="all")
        expect(tab.locator("#no-events")).to_have_text("None.")  # hidden here; no more will come
        expect(tab.locator("#axis")).to_have_text("seconds since the start of the session")
        expect(count).to_have_text("0")  # of the instant chosen, still
        tab.get_by_role("combobox", name="Window").select_option(label="10 s")
        slider.press("PageUp")
        slider.press("Shift+ArrowRight")
        slider.press("ArrowRight")
        expect(tab.locator("#instant-text")).to_contain_text("0:11.1")
        expect(count).to_have_text("11")
        tab.get_by_role("button", name="0:40.0").click()
        expect(count).to_have_text("41")
        expect(tab.locator("#state")).to_have_attribute("data-slip", "true")
        tab.get_by_role("button", name="Play").click()
        expect(tab.locator("#state")).to_have_attribute("data-slip", "false")  # having passed its end
        tab.get_by_role("button", name="Stop").click()
        expect(tab.locator("#link")).to_have_text("Recorded")
    assert watched.complaints == []


def test_space_plays_and_stops_unless_the_focused_element_uses_it(watched: Watched, run: Run) -> None:
    tab = watched.tab
    with ServedRecording(a_minute(run)) as served:
        tab.goto(served.url)
        play, stop = (tab.get_by_role("button", name=name, exact=True) for name in ("Play", "Stop"))
        slider = tab.get_by_role("slider", name="Time in the session")
        expect(slider).to_have_accessible_description(re.compile("^Space: play or stop"))
        expect(play).to_have_attribute("aria-keyshortcuts", "Space")
        expect(tab.locator("#instant-text")).to_contain_text("0:41.0")
        tab.keyboard.press("Space")  # nothing has the focus
        expect(stop).to_be_visible()
        slider.focus()
        tab.keyboard.press("Space")
        expect(play).to_be_visible()
        tab.keyboard.press("Control+Space")
        tab.get_by_role("combobox", name="Window").focus()
        tab.keyboard.press("Space")  # opens its list
        tab.keyboard.press("Escape")
        expect(play).to_be_visible()
        play.focus()
        tab.keyboard.press("Space")  # the button's own, and that is once
        expect(stop).to_be_visible()
        tab.keyboard.press("Space")
        expect(play).to_be_visible()
        tab.get_by_role("radio").focus()
        tab.keyboard.press("Space")
        tab.get_by_role("group", name="Slip events").focus()
        tab.keyboard.press("Space")  # scrolls
        expect(play).to_be_visible()
    assert watched.complaints == []


def test_thinned_curves_keep_the_figures_of_the_recording(watched: Watched, run: Run) -> None:
    """A row in a thousand is another; no figure may be that of its neighbours, nor its own theirs."""
    rows, odd = 200_000, 123_456
    recorded = SessionCurves(rule=Debounce(0.78))
    time = run.start + np.arange(rows) * 10 * ms
    probability = np.full(rows, 0.25)
    probability[odd] = 0.75
    counts = np.full((rows, 6), -10, np.int16)
    counts[odd] = -333
    onsets = np.arange(0, rows, 50)[:3000]
    state = (1 - np.arange(3000) % 2).astype(np.int8)

    async def fill() -> SessionPage:
        await recorded.open(run)
        await recorded.write(Zeroed(time, counts, counts, np.ones((rows, 6), np.bool_), finger=0))
        await recorded.write(Scores(time, probability, finger=0))
        await recorded.write(Slips(time[onsets], state, time[onsets], np.full(3000, 0.9), finger=0))
        await recorded.close()
        return SessionPage(recorded)

    tab = watched.tab
    with ServedRecording(fill()) as served:
        tab.goto(served.url)
        tab.get_by_role("combobox", name="Window").select_option(label="all")
        count, shown = tab.locator(".count").first, tab.locator("#probability")

        def go(row: int) -> None:
            tab.locator("#instant").evaluate(MOVE, 10 * row)

        go(odd)
        expect(count).to_have_text("333")
        expect(shown).to_have_text("0.75")
        for near in (odd - 1, odd + 1):  # within the same pixel
            go(near)
            expect(count).to_have_text("10")
            expect(shown).to_have_text("0.25")
        expect(tab.locator("#ramp-to")).to_have_text("400")  # the deepest of all
        expect(tab.locator("#events-count")).to_have_text("1,500 slips")
        expect(tab.locator("#some-events")).to_have_text("The first 1,000 of 3,000 events are listed.")
    assert watched.complaints == []
