"""`slipflow demo`: its page, and its end before it begins."""

import asyncio
import os
import re
import signal
import subprocess
from pathlib import Path
from shlex import split
from time import monotonic, sleep

import pytest

from connectors.sim.simulated_rig import SimulatedSource
from tests.command import SLIPFLOW, slipflow
from tests.connectors.web.reading import listening
from tests.waiting import PATIENCE, wait_until


def test_the_demo_serves_its_page_and_reports_what_it_detected(tmp_path: Path) -> None:
    command = [*SLIPFLOW, "demo", "--for", "10min", "--out", str(tmp_path / "of the demo")]
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
    show, python = (split(line) for line in output.splitlines() if re.search(" show | -c ", line))
    assert Path(show[-1]).parent == tmp_path / "of the demo" / "sessions"
    assert "counts" in subprocess.run(python, stdout=subprocess.PIPE, text=True, check=True).stdout


def test_ctrl_c_ends_the_compilation_of_a_demo_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def prepare(_: object) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        sleep(2 * PATIENCE)

    monkeypatch.setattr(SimulatedSource, "prepare", prepare)
    began = monotonic()
    done = slipflow("demo", "--no-browser", "--out", tmp_path / "recordings")
    assert (done.returncode, done.stdout) == (130, "")
    assert "error: " not in done.stderr
    assert monotonic() - began < PATIENCE
    assert not list(tmp_path.iterdir())
