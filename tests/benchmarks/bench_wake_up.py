"""How late asyncio wakes up, with its own selector and with ours, and the CPU time per wake-up.

Run by `make bench`. One task sleeps until the next of its instants, 3.1 ms apart, as a paced replay and the
simulated rig do. The turns of both loops alternate.
"""

import argparse
import asyncio
import os
import time
from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np

from connectors.punctual_loop import run_punctually
from tests.benchmarks.machine import commit, machine

PERIOD = 0.0031  # s


async def wake_up(number: int) -> tuple[list[float], float]:
    """Sleep until `number` instants; return how late each was, us, and the CPU time per wake-up, us."""
    loop, late = asyncio.get_running_loop(), list[float]()
    used, due = time.process_time(), loop.time()
    for _ in range(number):
        due += PERIOD
        if (wait := due - loop.time()) > 0:
            await asyncio.sleep(wait)
            late.append((loop.time() - due) * 1e6)
    return late, (time.process_time() - used) / number * 1e6


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--number", type=int, default=1000, help="wake-ups of a turn")
    options = parser.parse_args()
    print(f"{options.turns} turns of {options.number} wake-ups, commit {commit()}")
    print(machine())
    runs: dict[str, Callable[[Coroutine[Any, Any, Any]], Any]] = {
        "asyncio": asyncio.run,
        "punctual": run_punctually,
    }
    late: dict[str, list[float]] = {name: [] for name in runs}
    used: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(options.turns):
        for name, run in runs.items():
            found, cpu = run(wake_up(options.number))
            late[name] += found
            used[name].append(cpu)
    print(f"load {os.getloadavg()[0]:.1f} at the end")
    print(f"{'us':12}{'late p50':>10}{'p90':>10}{'p99':>10}{'CPU':>10}")
    for name, values in late.items():
        p50, p90, p99 = np.percentile(values, (50, 90, 99))
        print(f"{name:12}{p50:10.0f}{p90:10.0f}{p99:10.0f}{np.median(used[name]):10.0f}")


if __name__ == "__main__":
    main()
