"""`slipflow demo`: its page, and its end before it begins."""

import asyncio
import os
import re
import signal
import subprocess
from pathlib import Path

import pytest

from connectors.sim.simulated_rig import SimulatedSource
from tests.command import SLIPFLOW, slipflow
from tests.connectors.web.reading import listening
from tests.waiting import PATIENCE, wait_until


def test_the_demo_serves_its_page_and_reports_what_it_detected(tmp_path: Path) -> None:
    command = [*SLIPFLOW, "demo", "--for", "10min", "--out", str(tmp_path / "recordings")]
    log = tmp_path / "log"
    with log.open("w") as file:  # a pipe that nobody reads would stop the demo
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=file, text=True)

    def address() -> str:
        found = re.search(r"live page: (http://127\.0\.0\.1:\d+)\b", log.read_text())
        return found[1] if found else ""

    async def follow() -> None:
        async with listening(address(), within=2 * PATIENCE) as frames:
            about = (await anext(frames))["run"]
            assert (about["flow"], about["recording"], 0 < about["threshold"] < 1) == ("demo", None, True)
            rows = await anext(frame["rows"] async for frame in frames if "scores 0" in frame["rows"])
            assert "touch 0" in rows
            process.send_signal(signal.SIGTERM)
            *_, last = [frame async for frame in frames]
            assert last["end"] == {"error": None}

    try:
        wait_until(address, process, within=4 * PATIENCE)  # the first use compiles
        asyncio.run(follow())
        output, _ = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    assert process.returncode == 0
    assert re.search(r"\d+ true slips: \d+ detected, \d+ missed", output)


def test_a_demo_that_is_interrupted_before_it_begins_has_no_session_and_exits_130(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def prepare(_: object) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        await asyncio.sleep(PATIENCE)

    monkeypatch.setattr(SimulatedSource, "prepare", prepare)
    done = slipflow("demo", "--no-browser", "--out", tmp_path / "recordings")
    assert done.returncode == 130
    assert "error: " not in done.stderr
    assert "was stopped before it began" in done.stdout
    assert not list(tmp_path.iterdir())
