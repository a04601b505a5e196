import json
import re
import signal
import subprocess
import sys
from http.client import HTTPConnection
from pathlib import Path

import pytest
import typer

from connectors import Page
from flows import live_page
from flows.demo import Demo
from flows.graph import Flow
from flows.live_page import add_page, listening, shown
from flows.testing import TestSink, TestSource
from flows.validate import problems
from operators import Debounce, Touch, Zero

SLIPFLOW = [sys.executable, "-c", "from flows.command import main; main()"]


def names(flow: Flow) -> list[str]:
    return [node.gives.__name__ for node in shown(flow) if node.gives]


def page_of(flow: Flow) -> Page:
    [page] = [node.part for node in flow.nodes if isinstance(node.part, Page)]
    return page


def test_the_page_takes_what_it_can_show_of_the_demo(tmp_path: Path) -> None:
    demo = Demo(tmp_path, broker=None)
    assert names(demo.flow) == ["Zeroed", "Motion", "Scores", "Slips"]
    add_page(demo.flow)
    assert problems(demo.flow) == []
    [debounce] = [node.part for node in demo.flow.nodes if isinstance(node.part, Debounce)]
    assert page_of(demo.flow).threshold == debounce.threshold
    assert page_of(demo.flow).place == "http://127.0.0.1:8765"


def test_raw_touch_is_shown_where_none_is_zeroed_and_each_type_once() -> None:
    flow = Flow("raw")
    first = flow.source(TestSource(Touch), "first")
    first.to(TestSink())
    assert names(flow) == ["Touch"]
    (first | Zero()).to(TestSink())
    (first | Zero(baseline=700)).to(TestSink())
    assert names(flow) == ["Zeroed"]
    add_page(flow, "127.0.0.1:0")
    assert page_of(flow).threshold is None
    assert problems(flow) == []


@pytest.mark.parametrize("listen", ["8765", "host", "host:", ":80", "host:99999", "::1:80", "a b:80"])
def test_a_place_that_is_none_is_wrong_usage(listen: str) -> None:
    with pytest.raises(typer.BadParameter, match="HOST:PORT"):
        listening(listen)


def test_no_browser_is_opened_where_nobody_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = list[str]()
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setenv("DISPLAY", ":0")
    live_page.open_browser("http://localhost")  # stderr is no terminal here
    assert opened == []


def test_the_demo_serves_its_page_says_where_and_ends_well(tmp_path: Path) -> None:
    command = [*SLIPFLOW, "demo", "--out", str(tmp_path / "data"), "--for", "60s", "--json"]
    demo = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert demo.stderr
    address = next(
        filter(None, (re.search(r"live page: http://(127\.0\.0\.1):(\d+)", line) for line in demo.stderr))
    )
    connection = HTTPConnection(address[1], int(address[2]), timeout=30)
    connection.request("GET", "/stream")
    stream = connection.getresponse()
    lines = iter(stream.readline, b"")
    assert any(line == b"event: hello\n" for line in lines)
    hello = json.loads(next(lines).removeprefix(b"data: "))
    assert (hello["flow"], hello["live"], 0 < hello["threshold"] < 1) == ("demo", True, True)
    frames = (json.loads(line[6:]) for line in lines if line.startswith(b"data: {") and b'"scores"' in line)
    assert "0" in next(frames)["touch"]
    demo.send_signal(signal.SIGTERM)
    assert any(line == b"event: end\n" for line in lines)
    connection.close()
    output, _ = demo.communicate(timeout=30)
    assert demo.returncode == 0
    assert json.loads(output.splitlines()[-1])["sinks"]["page"]["dropped"] == 0


def test_a_page_for_others_without_a_token_is_one_line_that_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SLIPFLOW_PAGE_TOKEN", raising=False)
    trace = tmp_path / "trace.csv"
    trace.write_text("t,p0,p1,p2,p3,p4,p5\n" + "".join(f"{k / 100},1,2,3,4,5,6\n" for k in range(20)))
    command = [*SLIPFLOW, "run", "live", "--replay", str(trace), "--listen", "0.0.0.0:0"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("error: Page: token is None, must be set")
