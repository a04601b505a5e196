"""What the scene costs: simulated seconds per CPU second of one core.

Run by `make bench`. Single: one recording of five minutes. Batched: many trials of 20 s, each built anew.
Fingertips: as many on one arm, for 20 s; live: one sample at a time. All variants take turns, so that a
change of the machine's speed hits all of them; the table shows medians.
"""

import argparse
import gc
import statistics
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from connectors.sim.arm_motion import Controller
from connectors.sim.finger import Finger
from connectors.sim.paper_plan import PaperPlan
from connectors.sim.physics_parameters import Parameters
from connectors.sim.scene import Scene
from tests.benchmarks.machine import commit, machine

GRIDS = {24: (6, 4), 48: (8, 6), 96: (12, 8)}  # nodes: columns, rows
TRIAL = 20.0  # s


def scene(nodes: int) -> Scene:
    """Endless strokes over a plane."""
    columns, rows = GRIDS[nodes]
    return Scene(parameters=Parameters(columns=columns, rows=rows))


def single(nodes: int, seed: int) -> float:
    """One fingertip for five minutes."""
    Finger(scene(nodes), seed).take(30_000)
    return 300.0


def batched(nodes: int, seed: int, trials: int = 64) -> float:
    """Many trials, one after the other."""
    for trial in range(trials):
        Finger(scene(nodes), seed + trial).take(round(TRIAL * 100))
    return TRIAL * trials


def fingertips(count: int, seed: int) -> float:
    """Several fingertips for one trial."""
    for finger in range(count):
        Finger(scene(48), seed, finger).take(round(TRIAL * 100))
    return TRIAL * count


def live(count: int, seed: int) -> float:
    """Several fingertips, sample by sample."""
    fingers = [Finger(scene(48), seed, finger) for finger in range(count)]
    samples = 1600 // count
    for _ in range(samples):
        for finger in fingers:
            finger.take(1)
    return samples / 100 * count


def paper(repeats: int, seed: int) -> float:
    """Recordings of the paper's plan, both streams."""
    samples = 0
    for number, planned in enumerate(PaperPlan(repeats=repeats, rotations=repeats).scenes(seed)):
        taken = Finger(planned, seed + number).take(100_000)
        Controller(planned, seed + number).take(125_000)
        samples += len(taken[1]) if taken else 0
    return samples / 100


def variants(seed: int) -> dict[str, Callable[[], float]]:
    """What is measured: each simulates, and says how many seconds."""
    return {
        **{f"single, {n} nodes": partial(single, n, seed) for n in GRIDS},
        **{f"batched over trials, {n} nodes": partial(batched, n, seed) for n in GRIDS},
        **{f"fingertips: {n}, 48 nodes": partial(fingertips, n, seed) for n in (1, 4, 16)},
        **{f"fingertips live: {n}, 48 nodes": partial(live, n, seed) for n in (1, 4, 16)},
        "paper plan, both streams, 48 nodes": partial(paper, 1, seed),
    }


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    runs = variants(options.seed)
    speeds: dict[str, list[float]] = {name: [] for name in runs}
    gc.disable()
    for turn in range(options.turns + 1):  # the first one warms up
        for name, run in runs.items():
            began = time.process_time()
            simulated = run()
            if turn:
                speeds[name].append(simulated / (time.process_time() - began))
        gc.collect()
    print(f"seed {options.seed}, medians of {options.turns} turns, commit {commit()}")
    print(f"{machine()}, numpy {np.__version__}")
    print(f"{'simulated fingertip seconds per CPU second':44}{'median':>8}{'least':>8}{'most':>8}")
    for name, found in speeds.items():
        print(f"{name:44}{statistics.median(found):8.0f}{min(found):8.0f}{max(found):8.0f}")


if __name__ == "__main__":
    main()
