"""The page of a recorded session in a real browser: zoom, values, threshold and labels by hand."""

import re
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import ViewportSize, expect

from flows.cli.show import load
from operators.batch import Labelled, Motion, Touch, concat, ms, s
from storage import Session
from tests.connectors.web.browsing import MOVE, ServedRecording, Watched, drag, shaking, sideways
from tests.storage.made import record, write_pad

SECONDS = 12
START = 1_700_000_000 * s
SET = "(slider, to) => { slider.value = to; slider.dispatchEvent(new Event('input')); }"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a dataset of 12 s: touch that shakes each other second, with labels and motion."""
    touch = concat(Touch, shaking(SECONDS))
    time = touch.time + START + 5
    rows = len(time)
    label = ((np.arange(rows) > 200) & (np.arange(rows) // 100 % 2 == 0)).astype(np.int8)
    unknown, flags = np.full((rows, 6), np.nan), np.ones(rows, np.bool_)
    values = touch.counts, touch.temperature, touch.valid
    samples = Labelled(time, *values, unknown, unknown, flags, 0.01 * label, label, finger=0)
    motion = Motion(time, time, np.full((rows, 6), 0.001), unknown)
    batches = [Touch(time, *values, finger=0), samples, motion]
    root = tmp_path_factory.mktemp("recorded")
    with ThreadPoolExecutor(1) as pool:  # the browser has an event loop in this thread
        pool.submit(record, root, batches, part_rows=500).result()
    return root


@pytest.fixture
def session(recorded: Path, tmp_path: Path) -> Session:
    """Return a copy of the session, to be labelled."""
    return Session.open(copytree(recorded, tmp_path, dirs_exist_ok=True) / "sessions" / "one")


@pytest.fixture
def served(session: Session) -> Iterator[ServedRecording]:
    with ServedRecording(load(session, "psd")) as found:
        yield found


def spans(session: Session) -> list[tuple[float, float, str]]:
    """Return the newest labels by hand, in s since the start."""
    return [
        ((each.begin - START) / s, (each.end - START) / s, each.value) for each in session.hand_labels().spans
    ]


def test_a_time_is_selected_by_slider_keys_click_and_event(watched: Watched, served: ServedRecording) -> None:
    tab = watched.tab
    tab.goto(served.url)
    expect(tab.locator("#session")).to_have_text("Session one")
    slider, readout = tab.get_by_role("slider", name="Time in the session"), tab.locator("#readout")
    tab.locator("#instant").evaluate(MOVE, 4500)
    expect(readout).to_contain_text("0:04.50 · 22:13:24.50 UTC · counts ")
    for text in ("probability 0.", "TCP 1.7 mm/s", " · label slip"):
        expect(readout).to_contain_text(text)
    expect(tab.locator("h1")).to_have_text("Fingertip 0Slip")
    expect(slider).to_have_attribute("aria-valuetext", "0:04.50, slip")
    slider.press("Home")
    expect(tab.locator("h1")).to_have_text("Fingertip 0Unknown")  # before the first score
    slider.press("PageUp")
    slider.press("Shift+ArrowRight")
    slider.press("ArrowLeft")
    slider.press("Alt+ArrowLeft")
    expect(tab.locator("#instant-text")).to_contain_text("0:10.89")
    drag(tab, tab.locator("#counts"), 0.25, 0.25)
    expect(tab.locator("#instant-text")).to_contain_text(re.compile(r"0:0(2\.9|3\.0)"))
    tab.locator("#events button").first.click()
    expect(tab.locator("#state")).to_have_attribute("data-slip", "true")


def test_a_drag_zooms_and_escape_shows_the_whole_session(watched: Watched, served: ServedRecording) -> None:
    tab = watched.tab
    with tab.expect_request(re.compile(r"window\?begin=0&end=12000")):
        tab.goto(served.url)
    zoom_out = tab.get_by_role("button", name="Zoom out")
    expect(tab.locator("#readout")).to_contain_text("UTC")
    with tab.expect_request(re.compile(r"window\?begin=(29|30)\d\d&end=(59|60)\d\d&")):
        drag(tab, tab.locator("#counts"), 0.25, 0.5)
    expect(zoom_out).to_be_visible()
    with tab.expect_request(re.compile(r"window\?begin=44\d\d(\.5)?&end=(45|44|46)\d\d")):
        drag(tab, tab.locator("#scores"), 0.5, 0.51)
    with tab.expect_request(re.compile(r"window\?begin=0&end=12000")):
        tab.keyboard.press("Escape")
    expect(zoom_out).to_be_hidden()
    drag(tab, tab.locator("#counts"), 0.25, 0.5)
    with tab.expect_request(re.compile(r"window\?begin=(69|70)\d\d&end=10000&at=10000")):
        tab.locator("#instant").evaluate(MOVE, 10_000)  # the zoom moves with the selected time
    zoom_out.click()
    expect(zoom_out).to_be_hidden()


def test_the_threshold_slider_shows_what_debounce_finds(watched: Watched, served: ServedRecording) -> None:
    tab, counts = watched.tab, set[int]()
    tab.goto(served.url)
    for threshold in (0.005, 0.5, 1.0):
        tab.get_by_role("slider", name="Threshold").evaluate(SET, threshold)
        found: list[Any] = served.page.detected(threshold)
        onsets = sum(event["onset"] for event in found)
        expect(tab.locator("#threshold-text")).to_have_text(f"{threshold:g}")
        expect(tab.locator("#events-count")).to_have_text(f"{onsets} {'slip' if onsets == 1 else 'slips'}")
        counts.add(onsets)
    assert len(counts) > 1
    expect(tab.locator("#notice")).to_contain_text("found now at threshold 1.")
    tab.get_by_role("button", name="Reset").click()
    expect(tab.locator("#notice")).to_contain_text("Slip probability: computed now by detector psd.")


@pytest.mark.parametrize("width", [390, 1280])
def test_a_fingertip_without_a_detector_is_shown_in_its_unit_and_labelled(
    watched: Watched, tmp_path: Path, width: int
) -> None:
    tab, session = watched.tab, write_pad(tmp_path, fingers=(0, 1))
    tab.set_viewport_size(ViewportSize(width=width, height=844))
    with ServedRecording(load(session, "none")) as served:
        tab.goto(served.url)
        tab.get_by_role("slider", name="Time in the session").press("End")
        expect(tab.locator("#readout")).to_contain_text(" · kPa 7.47 7.47")
        expect(tab.locator(".count").last).to_have_text("7.47")
        expect(tab.locator("#ramp-to")).to_have_text("8.00")
        expect(tab.locator("#counts-unit")).to_have_text("kPa above the unloaded reading")
        expect(tab.locator("#unit")).to_have_text("kPa above the unloaded reading.")
        for hidden in ("#scores", "#probability", "#tuning", "#pause"):
            expect(tab.locator(hidden)).to_be_hidden()
        drag(tab, tab.locator("#bands"), 0.25, 1.0)
        tab.keyboard.press("s")
        tab.get_by_role("radio", name="Fingertip 1").check()
        tab.keyboard.press("t")
        tab.keyboard.press("Control+s")
        expect(tab.locator("#label-state")).to_have_text("2 spans, saved as version 1")
        assert sideways(tab) == 0
        assert tab.locator(".fingertips").evaluate("each => each.scrollWidth - each.clientWidth") == 0
        controls = tab.locator("button:visible, input:not([type=radio]):visible")
        least: float = controls.evaluate_all("all => Math.min(...all.map((each) => each.offsetHeight))")
        assert least >= (40 if width < 900 else 24)
        bands, save = tab.locator("#bands").bounding_box(), tab.locator("#label-save").bounding_box()
        assert bands
        assert save
        assert 0 < save["y"] + save["height"] - bands["y"] < 844, "a screen shows both"
        expect(tab.locator("h1")).to_have_text("Fingertip 1No detector")
    found = session.hand_labels().spans
    assert [(each.finger, each.value) for each in found] == [(0, "slip"), (1, "static")]
    assert all(each.end > START + 5 + 3980 * ms for each in found), "the last row is labelled"


def test_spans_are_marked_corrected_undone_and_saved_as_versions(
    watched: Watched, served: ServedRecording, session: Session
) -> None:
    tab = watched.tab
    tab.goto(served.url)
    state, bands = tab.locator("#label-state"), tab.locator("#bands")
    expect(state).to_have_text("No labels by hand yet")
    expect(tab.get_by_role("button", name="Slip", exact=True)).to_be_disabled()
    tab.get_by_label("Your name").fill("Ada")
    drag(tab, bands, 0.25, 0.5)
    expect(tab.locator("#label-selected")).to_contain_text("0:03.0")
    tab.keyboard.press("s")
    expect(state).to_have_text("1 span, not saved")
    drag(tab, tab.locator("#counts"), 0.75, 0.8)  # a zoom is no mark
    tab.keyboard.press("Escape")
    drag(tab, bands, 0.35, 0.4)
    tab.get_by_role("button", name="Unknown").click()
    expect(state).to_have_text("3 spans, not saved")
    tab.keyboard.press("Control+z")
    expect(state).to_have_text("1 span, not saved")
    tab.get_by_label("Note").fill("still hand")  # also after marking
    tab.get_by_role("button", name="Save").click()
    expect(state).to_have_text("1 span, saved as version 1")
    [(begin, end, value)] = spans(session)
    assert [begin, end] == pytest.approx([3, 6], abs=0.02)
    assert value == "slip"
    [saved] = session.hand_labels().spans
    assert (saved.author, saved.note, saved.created > START) == ("Ada", "still hand", True)

    tab.get_by_label("Your name").fill("Grace")
    slider = tab.get_by_role("slider", name="Time in the session")  # with keys only
    slider.press("Home")
    slider.press("Alt+[")  # as a German keyboard of a Mac sends it
    for _ in range(2):
        slider.press("Shift+ArrowRight")
    slider.press("Control+Alt+]")  # and some browsers with AltGr
    expect(tab.locator("#label-selected")).to_have_text("0:00.00 to 0:02.00 (2.00 s)")
    slider.press("t")
    slider.press("Control+s")
    expect(state).to_have_text("2 spans, saved as version 2")
    assert spans(session)[0][:2] == pytest.approx((0, 2), abs=1e-6)
    assert spans(session)[0][2] == "static"
    assert [each.author for each in session.hand_labels().spans] == ["Grace", "Ada"]  # as each was marked
    tab.reload()
    expect(state).to_have_text("2 spans, saved as version 2")
