"""The flow of the page for other fingertips, on a file that grows while it runs."""

import asyncio
from pathlib import Path

import pytest

from connectors.files.trace import Trace
from flows.graph.loading import load
from flows.run.live_runner import LiveRunner
from operators import s
from tests.pages import ROOT, block, blocks

PAGE = ROOT / "docs/how-to/any-fingertip.md"


@pytest.mark.virtual
async def test_a_growing_file_gives_the_alerts_of_its_replay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    exec(blocks(PAGE)[0].body, {})  # noqa: S102 - writes pad.csv
    for name in ("pad.py", "live_pad.py"):
        Path(name).write_text(block(PAGE, name), encoding="utf-8")
    Path("own.toml").write_text(Trace("pad.csv").columns.toml(), encoding="utf-8")
    names, *lines = Path("pad.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    log = Path("log.csv")
    log.write_text(names, encoding="utf-8")

    async def write() -> None:
        await asyncio.sleep(0.5)
        text = "".join(lines)
        for first in range(0, len(text), 3001):  # about 37 ms of lines; the last one is not complete
            _append(log, text[first : first + 3001])
            await asyncio.sleep(3001 / len(text) * 8)

    writing = asyncio.create_task(write())
    flow = load("live_pad.py").flow({"where": "log.csv", "detector": "psd"})
    run = await LiveRunner(flow, "run", duration=9 * s).execute()
    await writing
    assert run.sources["touch"].rows == len(lines)
    live = capsys.readouterr().out
    await LiveRunner(load("pad.py").flow({"detector": "psd"}), "replay").execute()
    replayed = capsys.readouterr().out
    found, expected = ([line.split("  ")[2] for line in each.splitlines()] for each in (live, replayed))
    assert found == expected
    assert "slip onset" in found


def _append(path: Path, text: str) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.write(text)
