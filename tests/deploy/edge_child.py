"""One fingertip at work, for `test_fingertip.py`: deploy/fingertip.py over an emulated bus, in this process.

It needs nothing that a small install leaves out: what the fingertip feels is a table, made before. Prints one
line of JSON.
"""

import argparse
import asyncio
import json
import sys
import time
from pathlib import Path

import numpy as np

from flows.graph import Flow
from flows.graph.loading import load
from flows.run.live_runner import LiveRunner
from operators.batch import Counts, ms, s
from operators.ports import Run

BUS = 99
HEAVY = ("aiohttp", "aiomqtt", "llvmlite", "numba", "polars", "pyarrow", "scipy", "torch")


class Table:
    """What the fingertip feels, in rows 10 ms apart; it begins again when it ends."""

    def __init__(self, counts: Counts) -> None:
        """Rows are (n, 6)."""
        self._counts, self._began = counts, time.time_ns()

    def touch(self, finger: int, time: int) -> tuple[Counts, Counts]:
        """Counts of pressure and temperature at an instant (ns), (6,) each."""
        pressure = self._counts[max(0, time - self._began) // (10 * ms) % len(self._counts)]
        return pressure, np.full_like(pressure, 498)


async def work(flow: Flow, duration: int) -> Run:
    """Run for so long (ns)."""
    return await LiveRunner(flow, "edge", duration=duration).execute()


def main() -> None:
    """Work, and print what came of it."""
    sys.path.append(str(Path(__file__).parents[2]))  # for `tests` alone: the installed slipflow comes first
    from tests.emulators.i2c_bus import EmulatedI2cBus, served

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("flow", help="file of the flow")
    parser.add_argument("table", help="file of the counts that are felt, .npy")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--set", dest="settings", action="append", default=[], metavar="NAME=VALUE")
    options = parser.parse_args()
    settings = dict(each.split("=", 1) for each in options.settings)
    flow = load(options.flow).flow({"bus": str(BUS), **settings})
    with served(EmulatedI2cBus(Table(np.load(options.table))), f"/dev/i2c-{BUS}"):
        run = asyncio.run(work(flow, round(options.seconds * s)))
    result = {
        "rows": run.sources[next(iter(run.sources))].rows,
        "dropped": run.sinks["dataset"].dropped,
        "loaded": [name for name in HEAVY if sys.modules.get(name)],
    }
    sys.stdout.write(json.dumps(result) + "\n")


if __name__ == "__main__":
    main()
