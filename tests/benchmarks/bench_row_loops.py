"""CPU time per row of the operators that are compiled loops, compiled and as plain Python.

Run by `make bench`. The streams are those of the conformance suite, with gaps, late rows and faults. `Align`
gets as many rows of motion as of touch. The turns of all kinds alternate.
"""

import argparse
import os
from time import process_time
from typing import Any

import numpy as np
import pytest

from operators import Align, Debounce, DeviceClock, Follow, Health, Label, Pool, Resample, WatchClock, ms
from operators.operator import Step
from tests.benchmarks.machine import commit, machine
from tests.operators.plain_loops import use_plain_loops
from tests.operators.test_conformance import CASES

STEPS: tuple[Step, ...] = (
    Align(),
    Label(),
    Label(rotation=0.2, delay=37 * ms),
    Debounce(),
    Health(),
    DeviceClock(),
    WatchClock(),
    Follow(scans=30),
    Resample(),
    Pool(gain=0.25),
)
SIZES = 1, 100  # rows of a batch


def cpu_time(step: Step, rows: int, size: int) -> float:
    """Return the CPU time per row of a new operator, us."""
    case = next(each for each in CASES if each.step == step)
    streams = case.streams(0, rows)
    slices = [tuple(each[first : first + size] for each in streams) for first in range(0, rows, size)]
    fresh: Any = step.reset_copy()
    fresh.prepare()
    began = process_time()
    for each in slices:
        fresh.push(*each)
    return (process_time() - began) / rows * 1e6


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--rows", type=int, default=5000)
    options = parser.parse_args()
    print(f"{options.rows} rows, medians of {options.turns} turns, commit {commit()}")
    print(machine())
    found: dict[tuple[str, int, bool], list[float]] = {}
    for _ in range(options.turns):
        for step in STEPS:
            for size in SIZES:
                for plain in (False, True):
                    with pytest.MonkeyPatch.context() as patch:
                        if plain:
                            use_plain_loops(patch)
                        time = cpu_time(step, options.rows, size)
                    found.setdefault((repr(step), size, plain), []).append(time)
    print(f"load {os.getloadavg()[0]:.1f} at the end")
    print(f"{'CPU us per row':16}{'compiled, batches of 1':>24}{'100':>8}{'plain, 1':>12}{'100':>8}")
    for step in STEPS:
        name = type(step).__name__ + (", delayed" if getattr(step, "delay", 0) else "")
        medians = [
            float(np.median(found[repr(step), size, kind])) for kind in (False, True) for size in SIZES
        ]
        print("{:16}{:24.1f}{:8.2f}{:12.1f}{:8.1f}".format(name, *medians))


if __name__ == "__main__":
    main()
