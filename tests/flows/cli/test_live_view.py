import sys
from io import StringIO
from pathlib import Path
from queue import Queue

import pytest

from connectors import Metrics, Page
from flows import demo as ready_made
from flows.cli.live_view import add_metrics, add_page, announce_page
from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from flows.graph.validation import problems
from operators import TAKKTILE, Debounce, Health, Run, Score, Touch, Zero
from operators.batch import Faults, Scores, Slips, Zeroed
from storage import load_detector
from tests.command import Terminal
from tests.flows.run.live import Described, flow_of
from tests.waiting import PATIENCE


def page_of(flow: Flow) -> tuple[Page, list[str]]:
    """Return the page of a flow and the types of the streams that it shows."""
    [(node, page)] = [(node, sink) for node, sink in flow.sinks().items() if isinstance(sink, Page)]
    return page, [each.gives.__name__ for each in node.inputs if each.gives]


def test_the_page_shows_the_streams_of_the_demo(tmp_path: Path) -> None:
    flow = ready_made.demo(str(tmp_path))
    add_page(flow)
    page, names = page_of(flow)
    assert names == ["Zeroed", "Motion", "Scores", "Slips", "Faults"]
    assert problems(flow) == []
    [debounce] = [node.part for node in flow.nodes if isinstance(node.part, Debounce)]
    assert page.threshold == debounce.threshold
    assert page.destination == "http://127.0.0.1:8765"


@pytest.mark.parametrize("zeroed", [False, True])
def test_raw_touch_is_shown_if_none_is_zeroed_and_each_type_once(*, zeroed: bool) -> None:
    flow = Flow("raw")
    first = flow.source(TestSource(Touch), "first")
    first.to(TestSink())
    if zeroed:
        (first | Zero()).to(TestSink())
        (first | Zero(baseline=700)).to(TestSink())
    add_page(flow, "127.0.0.1:0")
    page, names = page_of(flow)
    assert (names, page.threshold) == (["Zeroed" if zeroed else "Touch"], None)
    assert problems(flow) == []


def test_page_and_metrics_show_all_fingertips_of_a_flow_with_a_source_for_each() -> None:
    flow = Flow("hand")
    for finger in range(3):
        touch = flow.source(Described(TAKKTILE, (finger,)), f"touch{finger}")
        touch.to(TestSink())
        if finger == 1:
            (touch | Health()).to(TestSink())
        (touch | Zero() | Score(load_detector("psd")) | Debounce()).to(TestSink())
    add_page(flow, "127.0.0.1:0")
    add_metrics(flow, "127.0.0.1:9464")
    assert problems(flow) == []
    for sink, *kinds in (Page, Zeroed, Scores, Slips, Faults), (Metrics, Slips, Faults, Scores):
        [node] = [node for node, part in flow.sinks().items() if isinstance(part, sink)]
        shown = [(each.gives, finger) for each in node.inputs for finger in each.fingers]
        assert sorted(shown, key=str) == sorted(((k, f) for k in kinds for f in range(3)), key=str)


def test_the_token_is_printed_on_terminals_only(monkeypatch: pytest.MonkeyPatch) -> None:
    url, entrance = "http://127.0.0.1:8765", "http://127.0.0.1:8765/?token=0123456789abcdef"
    for stream, text in (
        (Terminal(), f"live page: {entrance}\n"),
        (StringIO(), f"live page: {url} (asks for its token)\n"),
    ):
        monkeypatch.setattr(sys, "stderr", stream)
        announce_page("live page", url, entrance, browse=False)
        assert stream.getvalue() == text


@pytest.mark.parametrize("program", ["stdout", "stderr"])
def test_a_browser_opens_only_for_a_person(monkeypatch: pytest.MonkeyPatch, program: str) -> None:
    opened = Queue[str]()
    monkeypatch.setattr("webbrowser.open", opened.put)
    monkeypatch.setenv("DISPLAY", ":0")
    for stream in ("stdout", "stderr"):
        monkeypatch.setattr(sys, stream, Terminal())
    monkeypatch.setattr(sys, program, StringIO())
    announce_page("page", "http://one", "http://one", browse=True)
    monkeypatch.setattr(sys, program, Terminal())
    announce_page("page", "http://two", "http://two", browse=False)
    announce_page("page", "http://three", "http://three/?token=secret", browse=True)
    assert opened.get(timeout=PATIENCE) == "http://three"  # the first, and without its token


async def test_the_metrics_are_announced_once_they_are_served(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = list[str]()
    monkeypatch.setattr("flows.cli.live_view.note", said.append)
    flow = flow_of(TestSource(Scores), TestSink(), through=[Debounce()])
    add_metrics(flow, "127.0.0.1:0")
    [(node, metrics)] = [(node, sink) for node, sink in flow.sinks().items() if isinstance(sink, Metrics)]
    assert [parent.gives for parent in node.inputs] == [Slips, Scores]
    await metrics.open(run)
    assert said == [f"metrics: {metrics.url}"]
    await metrics.close()
