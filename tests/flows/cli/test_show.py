import asyncio
import json
import os
import re
import signal
import subprocess
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from http.client import HTTPConnection
from pathlib import Path
from socket import socket
from time import sleep
from typing import Any

import pytest

from connectors.web.access import TOKEN
from flows.cli.show import load, show
from flows.demo import demo
from flows.graph.testing import run_virtually
from flows.run.clocks import LoopClock
from flows.run.live_runner import LiveRunner
from operators import ParameterError, s
from storage import Session
from tests.command import slipflow
from tests.storage.made import write_pad
from tests.waiting import PATIENCE


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Session of 12 s of the demo."""
    out = tmp_path_factory.mktemp("data")

    async def main() -> None:
        await LiveRunner(
            demo(str(out)), "test", clock=LoopClock(1_700_000_000 * s), duration=12 * s
        ).execute()

    run_virtually(main())
    return Session.open(out)


def test_a_session_is_shown_with_recorded_slips_and_new_scores(session: Session) -> None:
    recorded = asyncio.run(load(session))
    contents: dict[str, Any] = {**recorded.contents()}
    assert contents["session"] == "test"
    assert contents["length"] == pytest.approx(12_000, abs=200)
    assert (contents["detector"], contents["recorded"]) == ("tcn", True)
    assert [event["t"] for event in contents["events"]] == [
        (time - recorded.start) / 1e6 for time in session.frame("slips")["time"].to_list()
    ]
    rows: Any = recorded.window(2_000, 3_000, 1000)["rows"]
    assert len(rows["touch 0"]["t"]) == pytest.approx(100, abs=2)
    assert len(rows["scores 0"]["t"]) == pytest.approx(100, abs=2)
    assert len(rows["speed every"]["t"]) == pytest.approx(125, abs=2)
    onset = next(event["t"] for event in contents["events"] if event["onset"])
    seen: dict[str, Any] = {**recorded.window(onset - 1000, onset, None)}
    assert seen["rows"]["scores 0"]["v"][0] >= recorded.rule.threshold


Ask = Callable[..., Any]


def is_open(port: int) -> bool:
    with socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def serve(folder: Path, visit: Callable[[Ask], None]) -> subprocess.CompletedProcess[str]:
    """Serve a session, visit its page in a thread, and press Ctrl-C."""
    with socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]

    def ask(path: str, body: object = None) -> Any:
        headers = {"Origin": f"http://127.0.0.1:{port}", "Content-Type": "application/json"}
        method, sent = ("GET", None) if body is None else ("POST", json.dumps(body))
        with closing(HTTPConnection("127.0.0.1", port, timeout=PATIENCE)) as connection:
            connection.request(method, path, sent, headers)
            return json.loads(connection.getresponse().read())

    def visit_and_end() -> None:
        try:
            while not is_open(port):
                sleep(0.05)
            visit(ask)
        finally:
            os.kill(os.getpid(), signal.SIGINT)

    with ThreadPoolExecutor(1) as pool:
        visited = pool.submit(visit_and_end)
        done = slipflow("show", folder, "--listen", f"127.0.0.1:{port}", "--no-browser")
        visited.result()
    return done


def test_a_fingertip_that_the_default_was_not_made_for_is_shown_and_labelled_without_scores(
    tmp_path: Path,
) -> None:
    session = write_pad(tmp_path)

    def visit(ask: Ask) -> None:
        about = ask("/about.json")
        assert (about["detector"], about["recorded"], about["events"]) == (None, False, [])
        window = ask("/window?begin=0&end=4000&at=3900&columns=1000")
        assert [*window["rows"]] == ["touch 0"]
        newest = window["rows"]["touch 0"]["v"][-1]
        assert newest == window["at"]["rows"]["touch 0"]["v"][0] == [747] * 9
        span = {"begin": 2400, "end": 3000, "finger": "0", "value": "slip"}
        span |= dict.fromkeys(("author", "note", "created"), "")
        assert ask("/labels", {"based_on": 0, "spans": [span]})["version"] == 1

    done = serve(tmp_path, visit)
    assert done.returncode == 0
    line = done.stderr.splitlines()[0]
    assert re.match(r"one: shown without scores: tcn needs 6 cells, .*; the data has 9 cells, .*kPa", line)
    assert "train a detector with `slipflow train`, or give one with --detector FILE" in line
    assert [each.value for each in session.hand_labels().spans] == ["slip"]


@pytest.mark.parametrize("token", [None, "short"])
def test_an_invalid_token_is_an_error_before_anything_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, token: str | None
) -> None:
    monkeypatch.delenv(TOKEN, raising=False)
    if token:
        monkeypatch.setenv(TOKEN, token)
    with pytest.raises(ParameterError, match="Page: token"):
        show(tmp_path / "none", listen="0.0.0.0:0")  # not read: that would be another error
