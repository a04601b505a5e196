"""What the dataflow costs, against what people would use instead: the job of `bench_engine`.

Run by `make bench`. Each engine does the job in a process and an environment of its own, pinned to a release;
the first call installs them under ~/.cache/slipflow-bench. Each must give the reference's labels and scores
bit for bit, or the table says that it differs, and the exit status is 1. All take turns; the table shows
medians of CPU time, and its ratio to slipflow's in batches of 1 and of 1000 within the same turn: below 1 the
engine is cheaper. What each program does is in the folder `peers`.
"""

import argparse
import os
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np

from operators.batch import Codes, Motion, Reals, Touch, ms
from tests.benchmarks.bench_engine import LENGTH, plain, streams
from tests.benchmarks.machine import commit, machine
from tests.benchmarks.peers.environments import PINS, PeerError, carry_out

FINGERS = (1, 64)
PATIENCE = 900.0  # s, for one run
LIVE, BATCHED = "slipflow, batches of 1", "slipflow, batches of 1000"  # what the ratios are to


class Variant(NamedTuple):
    """A row of the table."""

    name: str
    peer: str  # whose environment it runs in
    module: str
    rows: int = 1  # of a batch or chunk


VARIANTS = (
    *(Variant(f"slipflow, batches of {n}", "slipflow", "slipflow_batches", n) for n in (1, 10, 100, 1000)),
    Variant("slipflow, whole", "slipflow", "slipflow_batches", 10_000_000),
    Variant("plain Python push graph, records", "plain", "push_graph"),
    Variant("csp, Python nodes, records", "csp", "csp_python"),
    Variant("bytewax, records", "bytewax", "bytewax_flow"),
    Variant("bytewax, chunks of 100", "bytewax", "bytewax_flow", 100),
    Variant("bytewax, chunks of 1000", "bytewax", "bytewax_flow", 1000),
)


class Expected(NamedTuple):
    """The reference's results from the first complete window on, one fingertip after the other."""

    label: Codes  # (k,)
    score: Reals  # (k,)

    def difference(self, label: Codes, score: Reals) -> str:
        """What is not the same, bit for bit; nothing if all is."""
        for name, ours, theirs in (("labels", self.label, label), ("scores", self.score, score)):
            if len(ours) != len(theirs):
                return f"DIFFERS: {len(theirs)} {name}, not {len(ours)}"
            if ours.tobytes() != theirs.tobytes():
                return f"DIFFERS: {np.count_nonzero(ours != theirs)} of {len(ours)} {name}"
        return ""


def labels(touch: Touch, motion: Motion) -> Codes:
    """The reference's labels, (n,)."""
    newest = motion.time.searchsorted(touch.time, "right") - 1  # (n,) -1: none
    near = (newest >= 0) & (touch.time - motion.time[newest] <= 20 * ms)
    speed = np.where(near, np.hypot(*motion.velocity[newest, :2].T), np.nan)
    return np.where(speed < 0.3, speed > 0.003, -1).astype(np.int8)


def written(path: Path, fingers: int, samples: int, seed: int) -> Expected:
    """Write the input, and say what must come of it."""
    made = [streams(samples, seed + finger) for finger in range(fingers)]
    motion = made[0][1]
    touches = [touch for touch, _ in made]
    np.savez(
        path,
        time=np.array([touch.time for touch in touches]),
        counts=np.array([touch.counts for touch in touches]),
        motion_time=motion.time,
        velocity=motion.velocity,
    )
    return Expected(
        np.concatenate([labels(touch, motion)[LENGTH - 1 :] for touch in touches]),
        np.concatenate([plain(touch, motion) for touch in touches]),
    )


def spent(variant: Variant, source: Path, expected: Expected) -> float:
    """CPU time of one run, s.

    Raises:
        PeerError: if it fails, or gives something else than the reference.
    """
    target = source.with_name("result.npz")
    target.unlink(missing_ok=True)
    carry_out(variant.peer, variant.module, str(source), str(target), str(variant.rows), limit=PATIENCE)
    with np.load(target, allow_pickle=False) as result:
        if difference := expected.difference(result["label"], result["score"]):
            raise PeerError(difference)
        return float(result["spent"])


def cells(cost: list[float], one: list[float], thousand: list[float], samples: int) -> str:
    """A variant's cost at one number of fingertips, and its ratios."""
    text = f"{median(cost) / samples * 1e6:10.2f}"
    for other in (one, thousand):
        text += f"{median(a / b for a, b in zip(cost, other, strict=True)):9.2f}" if other else f"{'?':>9}"
    return text


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=20_000, help="of one fingertip; of each of 64 a tenth")
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--peer", action="append", choices=sorted(PINS), help="only these, beside slipflow")
    options = parser.parse_args()
    chosen = {"slipflow", *(options.peer or PINS)}
    variants = [variant for variant in VARIANTS if variant.peer in chosen]
    lengths = {fingers: options.samples // (1 if fingers == 1 else 10) for fingers in FINGERS}
    cost = defaultdict[tuple[str, int], list[float]](list)
    failed = dict[tuple[str, int], str]()
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory(prefix="slipflow-bench-") as name:
        sources = {fingers: Path(name) / f"{fingers}.npz" for fingers in FINGERS}
        expected = {f: written(sources[f], f, lengths[f], options.seed) for f in FINGERS}
        for turn in range(options.turns):
            for fingers in FINGERS:
                for variant in variants:
                    key = variant.name, fingers
                    if key in failed:
                        continue
                    try:
                        cost[key].append(spent(variant, sources[fingers], expected[fingers]))
                    except PeerError as error:
                        failed[key] = str(error)
                        cost.pop(key, None)  # an engine that fails once has no figure
                        print(f"{variant.name}, {fingers} fingertips: {error}", file=sys.stderr)
            print(f"turn {turn + 1} of {options.turns}", file=sys.stderr)
    print(
        f"{lengths[1]} samples of one fingertip, {lengths[64]} of each of 64; {options.turns} turns", end=""
    )
    print(f", seed {options.seed}, commit {commit()}")
    print(f"{machine()}, numpy {np.__version__}")
    print(
        f"load {load:.1f} at the beginning; {', '.join(pin for p in sorted(chosen) for pin in PINS[p][1:])}"
    )
    print(f"{'CPU us per barometer sample':36}" + "".join(f"{f'{f} fingertip(s)':>28}" for f in FINGERS))
    print(f"{'':36}" + f"{'us':>10}{': of 1':>9}{': 1000':>9}" * len(FINGERS))
    for variant in variants:
        row = f"{variant.name:36}"
        for fingers in FINGERS:
            key = variant.name, fingers
            if key in failed:
                row += f"  {failed[key]}"
            else:
                one, thousand = (cost[each, fingers] for each in (LIVE, BATCHED))
                row += cells(cost[key], one, thousand, lengths[fingers] * fingers)
        print(row)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
