"""What the dataflow costs, against what people would use instead: the job of `bench_engine`.

Run by `make bench`. Each engine does the job in a process and an environment of its own, pinned to a release;
the first call installs them under ~/.cache/slipflow-bench. Each must give the reference's labels and scores
bit for bit, or the table says that it differs, and the exit status is 1. All take turns; the table shows
medians of CPU time, and its ratio to slipflow's in batches of 1 and of 1000 within the same turn: below 1 the
engine is cheaper. What each program does is in the folder `peers`.
"""

import sys
import tempfile
from functools import partial
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np

from operators.batch import Codes, Motion, Reals, Touch, ms
from tests.benchmarks.bench_engine import plain, streams
from tests.benchmarks.machine import print_head
from tests.benchmarks.peers.environments import PINS, PeerError, Variant, carry_out, try_in_turns
from tests.benchmarks.peers.job import LENGTH

SAMPLES = {1: 20_000, 64: 2000}  # of each fingertip, by their number
TURNS = 5
PATIENCE = 900.0  # s, for one run
LIVE, BATCHED = "slipflow, batches of 1", "slipflow, batches of 1000"  # what the ratios are to


VARIANTS = (
    *(Variant(f"slipflow, batches of {n}", "slipflow", "slipflow_batches", str(n)) for n in (1, 100, 1000)),
    Variant("plain Python push graph, records", "plain", "push_graph"),
    Variant("csp, Python nodes, records", "csp", "csp_python"),
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


def written(path: Path, fingers: int) -> Expected:
    """Write the input, and say what must come of it."""
    made = [streams(SAMPLES[fingers], finger) for finger in range(fingers)]
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


def spent(source: Path, expected: Expected, variant: Variant) -> float:
    """CPU time of one run, s.

    Raises:
        PeerError: if it fails, or gives something else than the reference.
    """
    with np.load(carry_out(variant, source, PATIENCE), allow_pickle=False) as result:
        if difference := expected.difference(result["label"], result["score"]):
            raise PeerError(difference)
        return float(result["spent"])


def cells(cost: list[float], one: list[float], thousand: list[float], samples: int) -> str:
    """A variant's cost at one number of fingertips, and its ratios."""
    text = f"{median(cost) / samples * 1e6:10.2f}"
    for other in (one, thousand):
        text += f"{median(a / b for a, b in zip(cost, other, strict=True)):9.2f}" if other else f"{'?':>9}"
    return text


def column(fingers: int) -> tuple[dict[str, str], bool]:
    """Return the cells of each variant at one number of fingertips, and whether one failed."""
    with tempfile.TemporaryDirectory(prefix="slipflow-bench-") as name:
        source = Path(name) / "job.npz"
        cost, failed = try_in_turns(VARIANTS, TURNS, partial(spent, source, written(source, fingers)))
    one, thousand = (cost.get(each, []) for each in (LIVE, BATCHED))
    samples = SAMPLES[fingers] * fingers
    found = {name: cells(each, one, thousand, samples) for name, each in cost.items()}
    return found | {name: f"  {why}" for name, why in failed.items()}, bool(failed)


def main() -> None:
    """Measure and print the table."""
    print_head(f"{SAMPLES[1]} samples of one fingertip, {SAMPLES[64]} of each of 64; {TURNS} turns")
    print(", ".join(pin for pins in PINS.values() for pin in pins[1:]))
    columns, failed = zip(*map(column, SAMPLES), strict=True)
    print(f"{'CPU us per barometer sample':36}" + "".join(f"{f'{f} fingertip(s)':>28}" for f in SAMPLES))
    print(f"{'':36}" + f"{'us':>10}{': of 1':>9}{': 1000':>9}" * len(SAMPLES))
    for variant in VARIANTS:
        print(f"{variant.name:36}" + "".join(each[variant.name] for each in columns))
    sys.exit(any(failed))


if __name__ == "__main__":
    main()
