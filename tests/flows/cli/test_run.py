"""`slipflow run` in processes of its own: output, exit codes, one-line errors."""

import json
import os
import re
import signal
import subprocess
from pathlib import Path

import polars as pl

from tests.command import SLIPFLOW, slipflow
from tests.waiting import PATIENCE, wait_until


def test_a_live_run_prints_one_json_object() -> None:
    done = slipflow("run", "live", "--for", "100ms", "--json")
    found = json.loads(done.stdout)
    assert list(found) == ["session", "flow", "seconds", "sources", "sinks", "error"]
    assert (found["flow"], found["error"]) == ("live", None)
    assert re.fullmatch(r"live-\d{8}T\d{6}\.\d{6}Z", found["session"])


def test_a_signal_completes_the_recording(tmp_path: Path) -> None:
    out = tmp_path / "data"
    process = subprocess.Popen(
        [*SLIPFLOW, "run", "record", "--set", f"out={out}"],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    journal = "sessions/*/journal/*.wal"
    wait_until(
        lambda: sum(path.stat().st_size for path in out.glob(journal)) > 150_000,  # about 3 s
        process,
        within=2 * PATIENCE,
    )
    process.send_signal(signal.SIGTERM)
    text, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "rows out, 0 dropped" in text
    [about] = out.glob("sessions/*/session.json")
    assert json.loads(about.read_text())["complete"] is True
    samples = pl.read_parquet(f"{out}/sessions/*/samples/*.parquet")
    assert len(samples) > 100
    assert samples["label"].is_in([-1, 0, 1]).all()
