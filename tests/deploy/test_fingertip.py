import json
import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np

from operators import Slips, Touch
from storage import Session
from tests.deploy.shipped import DEPLOY, LEFT_OUT

FLOW = str(DEPLOY / "fingertip.py")
CHILD = Path(__file__).with_name("edge_child.py")


def test_without_its_broker_and_the_packages_missing_at_the_edge_it_records_and_keeps_the_events(
    tmp_path: Path,
) -> None:
    """It runs for 8 s on a fingertip that is pressed and shakes."""
    rng = np.random.default_rng(0)
    counts = 500 + rng.integers(-1, 2, (600, 6)).astype(np.int16)
    counts[130:] += rng.integers(-60, 30, (470, 6)).astype(np.int16)  # a busy host scans less often
    np.save(tmp_path / "table.npy", counts)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]  # no server listens there once it is closed
    code = f"""
import runpy, sys
sys.modules.update(dict.fromkeys({sorted(LEFT_OUT)!r}))
runpy.run_path({str(CHILD)!r}, run_name="__main__")
"""
    words = [sys.executable, "-c", code, FLOW, str(tmp_path / "table.npy"), "--seconds", "8"]
    words += ["--set", f"broker=mqtt://127.0.0.1:{port}", "--set", f"out={tmp_path / 'out'}"]
    environment = {**os.environ, "NO_COLOR": "1", "XDG_STATE_HOME": str(tmp_path / "state")}
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["loaded"] == ["aiomqtt", "pyarrow"]
    assert found["dropped"] == 0
    session = Session.open(tmp_path / "out" / "sessions" / "edge")
    assert sum(len(batch) for batch in session.read(Touch, 0)) == found["rows"] > 0
    assert sum(len(batch) for batch in session.read(Slips, 0)) > 0
    assert "Connection refused" in done.stderr
    assert re.search(r": [1-9]\d* unsent events remain in \S+; the next run sends them", done.stderr)
