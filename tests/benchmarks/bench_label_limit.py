"""How right an observer is who knows the arm's motion exactly, but not how late each recording tells of it.

Every recording of the plan has a latency of its own. The observer's answer is the recording's own label,
shifted to one latency for all; the best one is the limit of every detector that feels the fingertip alone.
"""

from argparse import ArgumentParser

import numpy as np

from flows.lab.simulation import planned_recordings
from flows.learn.labelled_recordings import WARM_UP, simulated_recording
from flows.learn.splits import SPLITS
from operators.batch import SLIP
from tests.benchmarks.machine import commit

RATE = 100.0  # Hz
LATENCIES = (0.05, 0.06, 0.07, 0.08, 0.09)  # s
EDGE = 15  # samples at the end that a shift may lack


def main() -> None:
    """Simulate the plan and print the table."""
    options = ArgumentParser(description=__doc__)
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    right: dict[tuple[str, float], list[np.ndarray[tuple[int], np.dtype[np.bool_]]]] = {}
    for each in planned_recordings("paper", given.seed):
        slip = simulated_recording(each.scene, each.seed).label == SLIP
        for latency in LATENCIES:
            shift = round((latency - each.scene.motion.latency) * RATE)
            same = (np.roll(slip, shift) == slip)[WARM_UP:-EDGE]
            right.setdefault((each.split, latency), []).append(same)
    print(f"paper plan, seed {given.seed}, commit {commit()}; % of samples")
    print("| split | " + " | ".join(f"{1000 * latency:.0f} ms" for latency in LATENCIES) + " |")
    print("| --- |" + " ---: |" * len(LATENCIES))
    for split in SPLITS:
        shares = (100 * np.concatenate(right[split, latency]).mean() for latency in LATENCIES)
        print(f"| {split} | " + " | ".join(f"{share:.1f}" for share in shares) + " |")


if __name__ == "__main__":
    main()
