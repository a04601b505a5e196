import asyncio
import json
import os
import re
import signal
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from socket import socket
from time import sleep
from typing import Any
from urllib.error import URLError
from urllib.request import urlopen

import pytest

from flows.cli.show import load
from flows.demo import demo
from operators import Debounce, s
from storage import Session, load_debounce
from tests.command import slipflow
from tests.flows.run.live import execute
from tests.storage.made import write_pad
from tests.waiting import PATIENCE


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Session of 12 s of the demo."""
    out = tmp_path_factory.mktemp("data")
    execute(demo(str(out)), duration=12 * s, start=0)
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
    rows: Any = recorded.window(3_000, 4_000, 1000)
    assert len(rows["touch 0"]["t"]) == pytest.approx(100, abs=2)
    assert len(rows["scores 0"]["t"]) == pytest.approx(100, abs=2)
    assert len(rows["speed every"]["t"]) == pytest.approx(125, abs=2)
    psd = asyncio.run(load(session, "psd")).rule
    assert psd == load_debounce("psd") == Debounce(consecutive=2, release=10)
    onset = next(event["t"] for event in contents["events"] if event["onset"])
    seen: Any = recorded.window(onset - 1000, onset, None)
    assert seen["scores 0"]["v"][0] >= recorded.rule.threshold


@pytest.mark.parametrize("alone", [False, True])  # True: a copy of the session, without its dataset
def test_a_fingertip_that_the_default_was_not_made_for_is_shown_without_scores(
    tmp_path: Path, *, alone: bool
) -> None:
    folder = write_pad(tmp_path).folder
    folder = folder.rename(tmp_path / "one") if alone else folder
    with socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"

    def visit_and_end() -> Any:
        try:
            while True:
                with suppress(URLError), urlopen(f"http://{address}/about.json", timeout=PATIENCE) as answer:
                    return json.loads(answer.read())
                sleep(0.05)
        finally:
            os.kill(os.getpid(), signal.SIGINT)

    with ThreadPoolExecutor(1) as pool:
        visited = pool.submit(visit_and_end)
        done = slipflow("show", ".", "--listen", address, "--no-browser", cwd=folder)
    about = visited.result()
    assert (about["detector"], about["recorded"], about["events"]) == (None, False, [])
    assert done.returncode == 0
    line = done.stderr.splitlines()[0]
    assert re.match(r"one: shown without scores: tcn needs 6 cells, .*; the data has 9 cells, .*kPa", line)
    assert "train a detector with `slipflow train`, or give one with --detector FILE" in line
    data = folder if alone else tmp_path
    assert f"next: slipflow train {data} -o {data.name}.safetensors" in done.stderr
