"""How long an event takes from its sample's arrival, and the CPU it takes, against what people would use.

Run by `make bench`. Fingertips at 100 Hz, one engine at a time, in turns: the detection path of the job of
`bench_peers`, at every sample. `peers/live.py` says from where to where it is measured. Scores must be those
of the reference bit for bit. Fingertips take turns within the 10 ms of a scan. The table shows medians
of the turns.
"""

import sys
import tempfile
from functools import partial
from math import inf
from pathlib import Path

import numpy as np

from operators import Score, Touch, Zero, Zeroed, concat, ms
from operators.batch import Reals
from storage import load_detector
from tests.benchmarks.bench_engine import plain, streams
from tests.benchmarks.machine import print_head
from tests.benchmarks.peers.environments import PINS, PeerError, Variant, carry_out, try_in_turns

FINGERS = 8
SECONDS, TURNS = 20, 3
PERIOD = 10 * ms  # ns, of a fingertip
PERCENTILES = (50, 99, 99.9)
PATIENCE = 60.0  # s, for a run beside its length


ENERGY = "energy"  # the score of `bench_engine`; else a detector that ships
VARIANTS = (
    Variant("slipflow", "slipflow", "slipflow_live", ENERGY),
    Variant("slipflow, detector tcn", "slipflow", "slipflow_live", "tcn"),
    Variant("plain Python, called inline", "plain", "push_live", ENERGY),
    Variant("csp, Python nodes", "csp", "csp_live", ENERGY),
)


def written(path: Path) -> dict[str, Reals]:
    """Write the input, whose stamps are when samples are due, and say the scores by detector."""
    samples = SECONDS * 100
    made = [streams(samples, finger) for finger in range(FINGERS)]
    due = [np.arange(samples) * PERIOD + finger * PERIOD // FINGERS for finger in range(FINGERS)]
    nothing = np.empty((0, 6))
    counts = np.array([touch.counts for touch, _ in made])
    np.savez(path, time=np.array(due), counts=counts, motion_time=np.empty(0, np.int64), velocity=nothing)
    return {
        ENERGY: np.concatenate([plain(*each) for each in made]),
        "tcn": np.concatenate([judged(touch) for touch, _ in made]),
    }


def judged(touch: Touch) -> Reals:
    """What the shipped detector says of the whole stream at once."""
    zero = Zero(baseline=400, spike=inf)
    zeroed = concat(Zeroed, [zero.push(touch), zero.flush()])
    tcn = load_detector("tcn")
    scores = Score(tcn).push(zeroed).probability
    assert len(scores) == len(touch) - tcn.length + 1
    return scores


def measured(source: Path, scores: dict[str, Reals], variant: Variant) -> list[float]:
    """Percentiles of the latency, us, and the CPU, %.

    Raises:
        PeerError: if it fails, or gives something else than the reference.
    """
    expected = scores[variant.argument]
    with np.load(carry_out(variant, source, SECONDS + PATIENCE), allow_pickle=False) as result:
        if result["score"].tobytes() != expected.tobytes():
            same = len(result["score"]) == len(expected)
            many = np.count_nonzero(result["score"] != expected) if same else "number"
            raise PeerError(f"DIFFERS: {many} of {len(expected)} scores")
        late = np.percentile(result["delay"] / 1000, PERCENTILES).tolist()
        return [*late, 100 * float(result["used"])]


def main() -> None:
    """Measure and print the table."""
    print_head(f"{FINGERS} fingertips at 100 Hz, in turn, {SECONDS} s, medians of {TURNS} turns")
    print(", ".join(pin for pins in PINS.values() for pin in pins[1:]))
    with tempfile.TemporaryDirectory(prefix="slipflow-bench-") as name:
        source = Path(name) / "job.npz"
        found, failed = try_in_turns(VARIANTS, TURNS, partial(measured, source, written(source)))
    columns = "".join(f"{f'p{p:g}':>10}" for p in PERCENTILES)
    print(f"{'us from arrival to event':36}{columns}{'CPU, %':>10}")
    for variant in VARIANTS:
        if variant.name in failed:
            print(f"{variant.name:36}  {failed[variant.name]}")
        else:
            *late, used = np.median(found[variant.name], axis=0)
            print(f"{variant.name:36}" + "".join(f"{value:10.0f}" for value in late) + f"{used:10.1f}")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
