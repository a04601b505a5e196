"""One fingertip at work, for `bench_edge.py`: deploy/fingertip.py over an emulated bus, in this process.

It needs nothing that a small install leaves out: what the fingertip feels is a table, made before. The bus
and the table are in the memory and the CPU that are told. Prints one line of JSON.
"""

import argparse
import asyncio
import importlib.util
import json
import re
import sys
import threading
import time
from pathlib import Path

import numpy as np

from flows.graph.loading import load
from flows.run.live_runner import LiveRunner
from operators.batch import Counts, ms, s

BUS = 99
HEAVY = ("aiohttp", "aiomqtt", "llvmlite", "numba", "polars", "pyarrow", "scipy", "torch")


class Table:
    """What the fingertip feels; it begins again when it ends."""

    def __init__(self, counts: Counts, temperature: Counts) -> None:
        """Rows are 10 ms apart, (n, 6) each."""
        self._counts, self._temperature, self._began = counts, temperature, time.time_ns()

    def touch(self, finger: int, time: int) -> tuple[Counts, Counts]:
        """Counts of pressure and temperature at an instant (ns), (6,) each."""
        row = max(0, time - self._began) // (10 * ms) % len(self._counts)
        return self._counts[row], self._temperature[row]


def resident(field: str = "VmRSS") -> float:
    """Memory of this process now, or (VmHWM) the most that it ever was; MB (of 10^6 bytes).

    Not getrusage, whose maximum begins with that of the process that started this one.
    """
    status = Path("/proc/self/status").read_text(encoding="ascii")
    [kib] = re.findall(rf"^{field}:\s+(\d+) kB$", status, re.MULTILINE)
    return int(kib) * 1024 / 1e6


async def work(flow_file: str, table: Table, settings: dict[str, str], seconds: float) -> dict[str, object]:
    """Run for so long; gives what was used and done."""
    sys.path.append(str(Path(__file__).parents[2]))  # for `tests` alone: the installed slipflow comes first
    from tests.emulators.i2c_bus import EmulatedI2cBus, served  # noqa: PLC0415

    flow = load(flow_file).flow(settings)
    runner = LiveRunner(flow, "edge", duration=round(seconds * s))
    with served(EmulatedI2cBus(table), f"/dev/i2c-{BUS}"):
        running = asyncio.create_task(runner.execute())
        await asyncio.sleep(seconds / 2)
        wall, cpu, first = time.monotonic(), time.process_time(), resident()
        await asyncio.sleep(seconds / 4)
        wall, cpu, last = time.monotonic() - wall, time.process_time() - cpu, resident()
        threads = threading.active_count()
        run = await running
    return {
        "rss": [first, last],
        "peak": resident("VmHWM"),
        "cpu": cpu / wall,
        "threads": threads,
        "scans": next(iter(run.describe.values()))["scans"],
        "rows": run.sources[next(iter(run.sources))].rows,
        "sinks": {name: [sink.rows, sink.dropped] for name, sink in run.sinks.items()},
        "loaded": [name for name in HEAVY if sys.modules.get(name)],
        "numba": importlib.util.find_spec("numba") is not None,
    }


def main() -> None:
    """Work, and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("flow", help="file of the flow")
    parser.add_argument("table", help="file of what is felt: counts and temperature, .npz")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--set", dest="settings", action="append", default=[], metavar="NAME=VALUE")
    options = parser.parse_args()
    settings = dict(each.split("=", 1) for each in options.settings)
    with np.load(options.table) as arrays:
        table = Table(arrays["counts"], arrays["temperature"])
    result = asyncio.run(work(options.flow, table, {"bus": str(BUS), **settings}, options.seconds))
    print(json.dumps(result))


if __name__ == "__main__":
    main()
