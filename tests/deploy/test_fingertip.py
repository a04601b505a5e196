import json
import os
import re
import socket
import subprocess
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from flows.graph.loading import load
from flows.graph.validation import problems
from operators import Slips, Touch
from storage import Session
from tests.deploy.shipped import DEPLOY, LEFT_OUT

FLOW = str(DEPLOY / "fingertip.py")
CHILD = DEPLOY.parent / "tests" / "benchmarks" / "edge_child.py"


def work(folder: Path, *settings: str, without: Sequence[str] = ()) -> subprocess.CompletedProcess[str]:
    """Run for 8 s on a fingertip that is pressed and shakes, without some packages; record into `out`."""
    rng = np.random.default_rng(0)
    counts = 500 + rng.integers(-1, 2, (600, 6)).astype(np.int16)
    counts[130:] += rng.integers(-60, 30, (470, 6)).astype(np.int16)  # a busy host scans less often
    np.savez(folder / "table.npz", counts=counts, temperature=np.full_like(counts, 498))
    code = textwrap.dedent(f"""
        import runpy, sys
        sys.modules.update(dict.fromkeys({without!r}))
        runpy.run_path({str(CHILD)!r}, run_name="__main__")
    """)
    words = [FLOW, folder / "table.npz", "--seconds", "8"]
    words += [word for each in (*settings, f"out={folder / 'out'}") for word in ("--set", each)]
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "NO_COLOR": "1", "XDG_STATE_HOME": str(folder / "state")},
    )


def test_by_default_it_scores_a_fingertip_on_the_bus_and_publishes() -> None:
    flow = load(FLOW).flow()
    assert problems(flow) == []
    assert [type(node.part).__name__ for node in flow.sources()] == ["TakkTile"]
    assert {type(node.part).__name__ for node in flow.sinks()} == {"Console", "Mqtt"}


def test_it_records_into_a_folder_and_publishes_only_with_a_broker(tmp_path: Path) -> None:
    flow = load(FLOW).flow({"out": str(tmp_path), "broker": "none", "bus": "none"})
    assert problems(flow) == []
    assert {type(node.part).__name__ for node in flow.sinks()} == {"Console", "Dataset"}


def test_without_its_broker_and_the_packages_missing_at_the_edge_it_records_and_keeps_the_events(
    tmp_path: Path,
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]  # no server listens there once it is closed
    done = work(tmp_path, f"broker=mqtt://127.0.0.1:{port}", without=sorted(LEFT_OUT))
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["loaded"] == ["aiomqtt", "pyarrow"]
    assert found["sinks"]["dataset"][1] == 0
    session = Session.open(tmp_path / "out" / "sessions" / "edge")
    assert sum(len(batch) for batch in session.read(Touch, 0)) == found["rows"] > 0
    assert sum(len(batch) for batch in session.read(Slips, 0)) > 0
    assert "Connection refused" in done.stderr
    assert re.search(r": [1-9]\d* unsent events remain in \S+; the next run sends them", done.stderr)
