import json
import os
import re
import socket
import sys
from pathlib import Path

import numpy as np

from operators import Slips, Touch
from storage import Session
from tests.command import captured
from tests.deploy.shipped import DEPLOY, LEFT_OUT

WORK = """
import asyncio, json, sys

folder, *left_out = sys.argv[1:]
sys.modules.update(dict.fromkeys(left_out))  # as if they were not installed

import numpy as np
from flows.graph.loading import load
from flows.run.live_runner import LiveRunner
from operators.batch import s
from tests.emulators.i2c_bus import EmulatedI2cBus, Table, served

async def work(flow):
    return await LiveRunner(flow, "edge", duration=8 * s).execute()

flow = load(FLOW).flow({"bus": "99", "broker": BROKER, "out": folder + "/out"})
with served(EmulatedI2cBus(Table(np.load(folder + "/table.npy"))), "/dev/i2c-99"):
    run = asyncio.run(work(flow))
[source] = run.sources.values()
heavy = "aiohttp", "aiomqtt", "llvmlite", "numba", "polars", "pyarrow", "scipy", "torch"
loaded = [name for name in heavy if sys.modules.get(name)]
print(json.dumps({"rows": source.rows, "dropped": run.sinks["dataset"].dropped, "loaded": loaded}))
"""


def test_without_a_broker_and_the_packages_left_out_it_records_and_keeps_the_events(tmp_path: Path) -> None:
    """It runs for 8 s on a fingertip that is pressed and shakes."""
    rng = np.random.default_rng(0)
    counts = 500 + rng.integers(-1, 2, (600, 6)).astype(np.int16)
    counts[130:] += rng.integers(-60, 30, (470, 6)).astype(np.int16)  # a busy host scans less often
    np.save(tmp_path / "table.npy", counts)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]  # no server listens there once it is closed
    code = WORK.replace("FLOW", repr(str(DEPLOY / "fingertip.py")))
    code = code.replace("BROKER", repr(f"mqtt://127.0.0.1:{port}"))
    words = [sys.executable, "-c", code, str(tmp_path), *LEFT_OUT]
    environment = {**os.environ, "NO_COLOR": "1", "XDG_STATE_HOME": str(tmp_path / "state")}
    done = captured(*words, env=environment, cwd=DEPLOY.parent)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["loaded"] == ["aiomqtt", "pyarrow"]
    assert found["dropped"] == 0
    session = Session.open(tmp_path / "out" / "sessions" / "edge")
    assert sum(len(batch) for batch in session.read(Touch, 0)) == found["rows"] > 0
    assert sum(len(batch) for batch in session.read(Slips, 0)) > 0
    assert "Connection refused" in done.stderr
    assert re.search(r": [1-9]\d* unsent events remain in \S+; the next run sends them", done.stderr)
