"""The page of a recorded session in a real browser: zoom, readout, threshold and labels by hand."""

import re
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import expect

from connectors.web.session_page import SessionCurves
from connectors.web.session_requests import SessionPage
from flows.cli.show import load
from operators import Debounce, FaultKind
from operators.batch import Faults, Labelled, Motion, Scores, Touch, Truth, Zeroed, concat, ms, s
from operators.ports import Run
from storage import LabelSpan, Session
from tests.connectors.web.browsing import RIGHT, WIDTH_OF_AXIS, ServedRecording, Watched, drag, shaking
from tests.connectors.web.reading import slip
from tests.connectors.web.test_browser import MOVE
from tests.storage.made import record, write_pad

SECONDS = 12
START = 1_700_000_000 * s
SET = "(slider, to) => { slider.value = to; slider.dispatchEvent(new Event('input')); }"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a dataset of 12 s: touch that shakes each other second, with labels, truth and motion."""
    touch = concat(Touch, shaking(SECONDS))
    time = touch.time + START + 5
    rows = len(time)
    label = ((np.arange(rows) > 200) & (np.arange(rows) // 100 % 2 == 0)).astype(np.int8)
    unknown, flags = np.full((rows, 6), np.nan), np.ones(rows, np.bool_)
    values = touch.counts, touch.temperature, touch.valid
    samples = Labelled(time, *values, unknown, unknown, flags, 0.01 * label, label, finger=0)
    truth = Truth(time, 0.02 * label, np.ones(rows), np.zeros((rows, 3)), finger=0)
    motion = Motion(time, time, np.full((rows, 6), 0.001), unknown)
    batches = [Touch(time, *values, finger=0), samples, truth, motion]
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


def test_the_pointer_shows_all_values_of_its_time_in_all_charts(
    watched: Watched, served: ServedRecording
) -> None:
    tab = watched.tab
    tab.goto(served.url)
    expect(tab.locator("#bands-figure")).to_be_visible()
    tab.get_by_role("combobox", name="Window").select_option(label="all")
    chart = tab.locator("#scores")
    box = chart.bounding_box()
    assert box is not None
    tab.mouse.move(box["x"] + WIDTH_OF_AXIS + 0.375 * (box["width"] - WIDTH_OF_AXIS - RIGHT), box["y"] + 40)
    expect(tab.locator("#readout")).to_contain_text("0:04.50 · 22:13:24.50 UTC · counts ")
    for text in ("probability 0.", "TCP 1.7 mm/s", "arm label slip", "truth slip"):
        expect(tab.locator("#readout")).to_contain_text(text)
    lines = tab.locator(".hair")
    expect(lines).to_have_count(3)
    places = {lines.nth(k).evaluate("line => line.getBoundingClientRect().left") for k in range(3)}
    assert len(places) == 1
    tab.mouse.move(5, 5)
    expect(lines.first).to_be_hidden()
    expect(tab.locator("#readout")).not_to_contain_text("0:04.50")  # the selected time again
    assert watched.complaints == []


def test_a_drag_zooms_and_escape_goes_back(watched: Watched, served: ServedRecording) -> None:
    tab = watched.tab
    tab.goto(served.url)
    tab.get_by_role("combobox", name="Window").select_option(label="all")
    expect(tab.locator("#axis")).to_have_text("seconds since the start of the session")
    with tab.expect_request(re.compile(r"window\?begin=(29|30)\d\d&end=(59|60)\d\d&")):
        drag(tab, tab.locator("#counts"), 0.25, 0.5)
    expect(tab.get_by_role("button", name="Zoom out")).to_be_visible()
    with tab.expect_request(re.compile(r"window\?begin=44\d\d&end=(45|44|46)\d\d&")):
        drag(tab, tab.locator("#scores"), 0.5, 0.51)
    with tab.expect_request(re.compile(r"window\?begin=(29|30)\d\d&end=(59|60)\d\d&")):
        tab.keyboard.press("Escape")
    with tab.expect_request(re.compile(r"window\?begin=0&end=119\d\d&")):
        tab.get_by_role("button", name="Zoom out").click()
    expect(tab.get_by_role("button", name="Zoom out")).to_be_hidden()
    assert watched.complaints == []


def test_the_window_has_context_after_the_selected_time(watched: Watched, served: ServedRecording) -> None:
    tab = watched.tab
    tab.goto(served.url)
    expect(tab.locator("#instant-text")).to_contain_text("UTC")  # it answers keys now
    tab.get_by_role("combobox", name="Window").select_option(label="5 s")
    slider = tab.get_by_role("slider", name="Time in the session")
    slider.press("Home")
    with tab.expect_request(re.compile(r"window\?begin=1250&end=6250&at=5000&")):
        for _ in range(5):
            slider.press("Shift+ArrowRight")
    expect(tab.locator("#axis")).to_have_text("seconds from the selected time")
    slider.press("Alt+ArrowRight")
    expect(tab.locator("#readout")).to_contain_text("0:05.01")


def test_the_threshold_slider_shows_the_events_that_the_debounce_finds(
    watched: Watched, session: Session
) -> None:
    tab, pages = watched.tab, list[SessionPage]()

    async def loaded() -> SessionPage:
        pages.append(await load(session, "psd"))
        return pages[0]

    with ServedRecording(loaded()) as served:
        tab.goto(served.url)
        slider = tab.get_by_role("slider", name="Threshold")
        counts = set[int]()
        for threshold in (0.005, 0.5, 1.0):
            slider.evaluate(SET, threshold)
            found: list[Any] = pages[0].curves.detected(threshold)
            onsets = [each for each in found if each["onset"]]
            word = "slip" if len(onsets) == 1 else "slips"
            expect(tab.locator("#threshold-text")).to_have_text(f"{threshold:g} · {len(onsets)} {word}")
            counts.add(len(onsets))
        assert len(counts) > 1
        expect(tab.locator("#notice")).to_contain_text("found now at threshold 1.")
        tab.get_by_role("button", name="Reset").click()
        expect(tab.locator("#notice")).to_contain_text("Slip probability: computed now by detector psd.")
    assert watched.complaints == []


def test_a_fingertip_without_a_detector_is_shown_in_its_unit_and_labelled(
    watched: Watched, tmp_path: Path
) -> None:
    tab, session = watched.tab, write_pad(tmp_path)
    with ServedRecording(load(session, "none")) as served:
        tab.goto(served.url)
        tab.get_by_role("combobox", name="Window").select_option(label="all")
        tab.get_by_role("slider", name="Time in the session").press("End")
        expect(tab.locator("#readout")).to_contain_text(" · kPa 7.47 7.47")
        expect(tab.locator(".count").last).to_have_text("7.47")
        expect(tab.locator("#ramp-to")).to_have_text("8.00")
        expect(tab.locator("#counts-unit")).to_have_text("kPa above the unloaded reading")
        expect(tab.locator("#unit")).to_have_text("kPa above the unloaded reading.")
        for hidden in ("#scores", "#probability", "#tuning"):
            expect(tab.locator(hidden)).to_be_hidden()
        drag(tab, tab.locator("#bands"), 0.25, 0.75)
        tab.keyboard.press("s")
        tab.keyboard.press("Control+s")
        expect(tab.locator("#label-state")).to_have_text("1 span, saved as version 1")
    assert [value for _, _, value in spans(session)] == ["slip"]
    assert watched.complaints == []


def test_spans_are_marked_corrected_undone_and_saved_as_versions(
    watched: Watched, served: ServedRecording, session: Session
) -> None:
    tab = watched.tab
    tab.goto(served.url)
    tab.get_by_role("combobox", name="Window").select_option(label="all")
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
    tab.get_by_role("button", name="Save").click()
    expect(state).to_have_text("1 span, saved as version 1")
    [(begin, end, value)] = spans(session)
    assert [begin, end] == pytest.approx([3, 6], abs=0.02)
    assert value == "slip"
    assert session.hand_labels().spans[0].author == "Ada"
    assert session.hand_labels().spans[0].created > START

    slider = tab.get_by_role("slider", name="Time in the session")  # with keys only
    slider.press("Home")
    slider.press("[")
    for _ in range(2):
        slider.press("Shift+ArrowRight")
    slider.press("]")
    expect(tab.locator("#label-selected")).to_have_text("0:00.00 to 0:02.00 (2.00 s)")
    slider.press("t")
    slider.press("Control+s")
    expect(state).to_have_text("2 spans, saved as version 2")
    assert spans(session)[0][:2] == pytest.approx((0, 2), abs=1e-6)
    assert spans(session)[0][2] == "static"
    assert len(session.hand_labels(1).spans) == 1
    tab.reload()
    expect(state).to_have_text("2 spans, saved as version 2")
    assert watched.complaints == []


def test_name_and_note_typed_after_marking_are_saved(
    watched: Watched, served: ServedRecording, session: Session
) -> None:
    tab = watched.tab
    tab.goto(served.url)
    drag(tab, tab.locator("#bands"), 0.25, 0.5)
    tab.keyboard.press("s")
    tab.get_by_label("Your name").fill("Ada")
    tab.get_by_label("Note").fill("still hand")
    tab.get_by_label("Note").press("Control+s")
    expect(tab.locator("#label-state")).to_have_text("1 span, saved as version 1")
    drag(tab, tab.locator("#bands"), 0.6, 0.7)
    tab.keyboard.press("t")
    tab.get_by_label("Your name").fill("Grace")
    tab.get_by_role("button", name="Save").click()
    expect(tab.locator("#label-state")).to_have_text("2 spans, saved as version 2")
    assert [(each.author, each.note) for each in session.hand_labels(1).spans] == [("Ada", "still hand")]
    assert [each.author for each in session.hand_labels().spans] == ["Ada", "Ada"]  # as it was marked


def test_a_page_that_is_not_up_to_date_does_not_overwrite_labels(
    watched: Watched, served: ServedRecording, session: Session
) -> None:
    tab = watched.tab
    tab.goto(served.url)
    expect(tab.locator("#label-state")).to_have_text("No labels by hand yet")
    session.write_hand_labels([LabelSpan(START, START + 10 * ms, 0, "static")], based_on=0)
    drag(tab, tab.locator("#bands"), 0.25, 0.5)
    tab.keyboard.press("s")
    tab.get_by_role("button", name="Save").click()
    expect(tab.locator("#label-state")).to_contain_text("Not saved: ")
    expect(tab.locator("#label-state")).to_contain_text("has version 1 of hand labels, not 0")
    assert len(session.hand_labels().spans) == 1


def test_the_quality_is_that_of_the_selected_time_at_any_threshold(watched: Watched, run: Run) -> None:
    tab = watched.tab
    rows = np.arange(600)
    time = run.start + rows * 10 * ms
    zeros = np.zeros((600, 6), np.int16)
    probability = np.where(rows % 200 < 100, 0.1, 0.7)

    async def page() -> SessionPage:
        curves = SessionCurves(rule=Debounce(0.6))
        await curves.open(run)
        await curves.write(Zeroed(time, zeros, zeros, zeros == 0, finger=0))
        await curves.write(Scores(time, probability, finger=0))
        codes = np.array([3], np.int8), np.array([FaultKind.STUCK], np.int8), np.array([True])
        await curves.write(Faults(time[350:351], *codes, finger=0))
        await curves.write(slip(int(time[100]), 1))
        await curves.close()
        return SessionPage(curves)

    with ServedRecording(page()) as served:
        tab.goto(served.url)
        slider, quality = tab.locator("#instant"), tab.locator("#quality")
        expect(tab.locator("#events tr")).to_have_count(1)
        slider.evaluate(MOVE, 500)
        expect(quality).to_have_text("Quality: good")
        slider.evaluate(MOVE, 3900)
        expect(quality).to_have_text("Doubtful: barometer 3 stuck")
        expect(tab.locator(".pad td.fault")).to_contain_text("stuck")
        tab.get_by_role("slider", name="Threshold").evaluate(SET, 0.5)
        onsets = tab.locator("#events tr").filter(has_text="slip onset")
        expect(onsets).to_have_count(3)
        expect(onsets.last).to_contain_text("doubtful: barometer 3 stuck")
        expect(onsets.first).not_to_contain_text("doubtful")
    assert watched.complaints == []


def test_two_detectors_are_compared_at_the_same_time(watched: Watched, session: Session) -> None:
    tab = watched.tab
    with ServedRecording(load(session, "psd"), load(session, "tcn")) as served:
        tab.goto(served.url)
        expect(tab.locator("#session")).to_have_text("one by psd and one by tcn")
        left, right = (tab.frame_locator(f"iframe[title='one by {name}']") for name in ("psd", "tcn"))
        for pane, name in ((left, "psd"), (right, "tcn")):
            expect(pane.locator("#notice")).to_contain_text(f"by detector {name}.")
        left.get_by_role("slider", name="Time in the session").press("Home")
        left.get_by_role("slider", name="Time in the session").press("Shift+ArrowRight")
        expect(right.locator("#instant-text")).to_contain_text("0:01.0")
        right.get_by_role("combobox", name="Window").select_option(label="all")
        expect(left.locator("#axis")).to_have_text("seconds since the start of the session")
        tab.get_by_label("Link times").uncheck()
        right.get_by_role("slider", name="Time in the session").press("Shift+ArrowRight")
        expect(right.locator("#instant-text")).to_contain_text("0:02.0")
        tab.get_by_label("Link times").check()
        left.get_by_role("slider", name="Time in the session").press("Shift+ArrowRight")
        expect(left.locator("#instant-text")).to_contain_text("0:02.0")
        expect(right.locator("#instant-text")).to_contain_text("0:03.0")  # as far apart as they were set
        left.locator("#scores").hover(position={"x": 300, "y": 40})
        expect(right.locator(".hair").first).to_be_visible()
        left.get_by_role("slider", name="Time in the session").press("[")
        left.get_by_role("slider", name="Time in the session").press("Shift+ArrowRight")
        left.get_by_role("slider", name="Time in the session").press("]")
        left.get_by_role("slider", name="Time in the session").press("s")
        left.get_by_role("slider", name="Time in the session").press("Control+s")
        expect(left.locator("#label-state")).to_have_text("1 span, saved as version 1")
        expect(right.locator("#label-state")).to_have_text("1 span, saved as version 1")
    assert watched.complaints == []


def test_the_visible_span_is_exported_as_files_picture_and_link(
    watched: Watched, served: ServedRecording
) -> None:
    tab = watched.tab
    tab.goto(served.url)
    tab.get_by_role("combobox", name="Window").select_option(label="all")
    expect(tab.locator("#axis")).to_have_text("seconds since the start of the session")
    drag(tab, tab.locator("#counts"), 0.25, 0.5)
    expect(tab.get_by_role("button", name="Zoom out")).to_be_visible()
    begins = {"CSV": b"time,finger,p0,", "Parquet": b"PAR1", "MCAP": b"\x89MCAP0", "PNG": b"\x89PNG"}
    for name, begin in begins.items():
        with tab.expect_download() as download:
            tab.get_by_role("button", name=name, exact=True).click()
        assert re.fullmatch(
            rf"one-(2\.9|3\.0)\d-(5\.9|6\.0)\d\.{name.lower()}", download.value.suggested_filename
        )
        content = Path(download.value.path()).read_bytes()
        assert content.startswith(begin)
        assert len(content) > 5000, name
        if name == "CSV":
            assert 290 < len(content.splitlines()) < 310
    tab.get_by_role("slider", name="Time in the session").press("Home")
    tab.keyboard.press("Escape")
    drag(tab, tab.locator("#counts"), 0.25, 0.5)
    tab.get_by_role("button", name="Link").click()
    expect(tab.locator("#export-state")).to_contain_text(re.compile("Link copied|address bar"))
    instant, link = tab.locator("#instant-text").inner_text(), tab.url
    assert "zoom=" in link
    assert "threshold" not in link
    tab.goto("about:blank")
    with tab.expect_request(re.compile(r"window\?begin=(29|30)\d\d&end=(59|60)\d\d&")):
        tab.goto(link)
    expect(tab.locator("#instant-text")).to_have_text(instant)
    expect(tab.get_by_role("button", name="Zoom out")).to_be_visible()
    assert watched.complaints == []
