"""How long an event takes from its sample's arrival, and the CPU it takes, against what people would use.

Run by `make bench`. Fingertips at 100 Hz, one engine at a time, in turns: the detection path of the job of
`bench_peers`, at every sample. `peers/live.py` says from where to where it is measured. Scores must be those
of the reference bit for bit. Fingertips take turns within the 10 ms of a scan, or come together, as a
TakkTile's scan gives them. The table shows medians of the turns.
"""

import argparse
import os
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

import numpy as np

from operators import Score, Touch, Zero, ms
from operators.batch import Reals
from storage import load_detector
from tests.benchmarks.bench_engine import LENGTH, plain, streams
from tests.benchmarks.machine import commit, machine
from tests.benchmarks.peers.environments import PINS, PeerError, carry_out

FINGERS = 8
PERIOD = 10 * ms  # ns, of a fingertip
PERCENTILES = (50, 99, 99.9)
PATIENCE = 60.0  # s, for a run beside its length


class Variant(NamedTuple):
    """A row of the table."""

    name: str
    peer: str  # whose environment it runs in
    module: str
    detector: str = "energy"  # the score of `bench_engine`, or a detector that ships


VARIANTS = (
    Variant("slipflow", "slipflow", "slipflow_live"),
    Variant("slipflow, detector tcn", "slipflow", "slipflow_live", "tcn"),
    Variant("plain Python, called inline", "plain", "push_live"),
    Variant("csp, Python nodes", "csp", "csp_live"),
    Variant("bytewax", "bytewax", "bytewax_live"),
)
PEERS = sorted({variant.peer for variant in VARIANTS})


def written(path: Path, samples: int, seed: int, *, together: bool) -> dict[str, Reals]:
    """Write the input, whose stamps are when samples are due, and say the scores by detector."""
    made = [streams(samples, seed + finger) for finger in range(FINGERS)]
    apart = 0 if together else PERIOD // FINGERS
    due = [np.arange(samples) * PERIOD + finger * apart for finger in range(FINGERS)]
    nothing = np.empty((0, 6))
    counts = np.array([touch.counts for touch, _ in made])
    np.savez(path, time=np.array(due), counts=counts, motion_time=np.empty(0, np.int64), velocity=nothing)
    return {
        "energy": np.concatenate([plain(*each) for each in made]),
        "tcn": np.concatenate([judged(touch) for touch, _ in made]),
    }


def judged(touch: Touch) -> Reals:
    """What the shipped detector says of the whole stream at once."""
    scores = Score(load_detector("tcn")).push(Zero(baseline=400).push(touch)).probability
    assert len(scores) == len(touch) - LENGTH + 1
    return scores


def measured(variant: Variant, source: Path, expected: Reals, limit: float) -> list[float]:
    """Percentiles of the latency, us, and the CPU, %.

    Raises:
        PeerError: if it fails, or gives something else than the reference.
    """
    target = source.with_name("result.npz")
    target.unlink(missing_ok=True)
    carry_out(variant.peer, variant.module, str(source), str(target), variant.detector, limit=limit)
    with np.load(target, allow_pickle=False) as result:
        if result["score"].tobytes() != expected.tobytes():
            same = len(result["score"]) == len(expected)
            many = np.count_nonzero(result["score"] != expected) if same else "number"
            raise PeerError(f"DIFFERS: {many} of {len(expected)} scores")
        late = np.percentile(result["delay"] / 1000, PERCENTILES).tolist()
        return [*late, 100 * float(result["used"])]


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each run")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--together", action="store_true", help="all fingertips at once, as a scan gives them"
    )
    parser.add_argument("--peer", action="append", choices=PEERS, help="only these, beside slipflow")
    options = parser.parse_args()
    chosen = {"slipflow", *(options.peer or PEERS)}
    variants = [variant for variant in VARIANTS if variant.peer in chosen]
    found = defaultdict[str, list[list[float]]](list)
    failed = dict[str, str]()
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory(prefix="slipflow-bench-") as name:
        source = Path(name) / "job.npz"
        samples = round(options.seconds * 100)
        expected = written(source, samples, options.seed, together=options.together)
        for turn in range(options.turns):
            for variant in variants:
                if variant.name in failed:
                    continue
                try:
                    limit = options.seconds + PATIENCE
                    found[variant.name].append(measured(variant, source, expected[variant.detector], limit))
                except PeerError as error:
                    failed[variant.name] = str(error)
                    print(f"{variant.name}: {error}", file=sys.stderr)
            print(f"turn {turn + 1} of {options.turns}", file=sys.stderr)
    how = "together" if options.together else "in turn"
    print(
        f"{FINGERS} fingertips at 100 Hz, {how}, {options.seconds:.0f} s, medians of {options.turns} turns",
        end="",
    )
    print(f", seed {options.seed}, commit {commit()}")
    print(f"{machine()}, numpy {np.__version__}")
    print(
        f"load {load:.1f} at the beginning; {', '.join(pin for p in sorted(chosen) for pin in PINS[p][1:])}"
    )
    columns = "".join(f"{f'p{p:g}':>10}" for p in PERCENTILES)
    print(f"{'us from arrival to event':36}{columns}{'CPU, %':>10}")
    for variant in variants:
        if variant.name in failed:
            print(f"{variant.name:36}  {failed[variant.name]}")
        else:
            values = np.median(found[variant.name], axis=0)
            print(
                f"{variant.name:36}"
                + "".join(f"{value:10.0f}" for value in values[:-1])
                + f"{values[-1]:10.1f}"
            )
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
