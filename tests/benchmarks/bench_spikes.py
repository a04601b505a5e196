"""What the test of single readings in `Zero` prevents and costs: one bit wrong per second, and no bit wrong.

A spike is an error of one bit in one reading of a random cell. Without the test, `Zero` has no limit.
"""

from argparse import ArgumentParser
from collections.abc import Iterator
from math import inf
from pathlib import Path
from typing import Final

import numpy as np
import polars as pl

from connectors.sim.finger import Finger, simulate_scene
from connectors.sim.paper_plan import PaperPlan
from connectors.sim.scene import NO_VIBRATION, Move, Scene, Vibration
from flows.learn.labelled_recordings import scene_seed, simulated_recording
from flows.report.table import Table, Value
from operators import SLIP, Debounce, Score, Slips, Touch, Zero, Zeroed, concat, ms
from operators.batch import Codes, Counts
from storage import load_debounce, load_detector
from tests.benchmarks.machine import commit

TEN_MINUTES: Final = 60_000  # samples
SHAKEN: Final = Vibration(1.382e-4, 12.0)  # of the paper plan
DEBOUNCE: Final = load_debounce("tcn") or Debounce()


def touched(counts: Counts) -> Touch:
    """Return rows 10 ms apart."""
    return Touch(np.arange(len(counts)) * 10 * ms, counts, counts, np.ones(counts.shape, np.bool_))


def held(vibration: Vibration) -> Counts:
    """Return the counts of a fingertip that rests on a plane for ten minutes."""
    plan = Move("hold", 2.0, force=0.0), Move("hold", TEN_MINUTES / 100, force=2.0)
    taken = Finger(Scene(plan, vibration=vibration), 0).take(TEN_MINUTES)
    assert taken is not None
    return taken[0].counts


def damaged(counts: Counts, bit: int) -> Counts:
    """Return counts with a wrong bit in a random cell of a random row of each second."""
    random, changed = np.random.default_rng(bit), counts.copy()
    rows = np.arange(500, len(counts), 100)
    rows += random.integers(0, 99, len(rows))
    changed.view(np.uint16)[rows, random.integers(0, 6, len(rows))] ^= 1 << bit
    return changed


def slips(zeroed: Zeroed) -> Slips:
    """Return the events of the default detector."""
    return DEBOUNCE.reset_copy().push(Score(load_detector("tcn")).push(zeroed))


def onsets(zero: Zero, touch: Touch) -> int:
    """Return the number of events that begin."""
    return int((slips(concat(Zeroed, [zero.push(touch), zero.flush()])).state == SLIP).sum())


def prevented() -> Table:
    """Return false onsets per hour for each bit, without and with the test."""
    rows = list[list[Value]]()
    still, shaken = held(NO_VIBRATION), held(SHAKEN)
    for bit in range(16):
        row: list[Value] = [str(bit)]
        for counts in (still, shaken):
            touch = touched(damaged(counts, bit))
            row += [6 * onsets(zero, touch) for zero in (Zero(spike=inf), Zero())]
        rows.append(row)
    return Table(["wrong bit", "at rest", "with the test", "shaking arm", "with the test"], rows)


def labelled(real: Path | None) -> Iterator[tuple[str, list[tuple[Touch, Codes]]]]:
    """Yield recordings without wrong bits, with their labels, by set."""
    scenes = [(each, scene_seed(0, number)) for number, each in enumerate(PaperPlan().scenes(0))]
    yield "paper plan", [(simulate_scene(*each)[0], simulated_recording(*each).label) for each in scenes]
    for name in ("strokes", "grasps") if real else ():
        frames = [pl.read_parquet(file) for file in sorted((real or Path()).glob(f"{name}/*.parquet"))]
        columns = [(each.select(pl.col("^b[0-5]$")), each["label"]) for each in frames]
        yield (
            name,
            [
                (touched(counts.to_numpy().astype(np.int16)), label.to_numpy().astype(np.int8))
                for counts, label in columns
            ],
        )


def cost(real: Path | None) -> Table:
    """Return accuracy and delay of the default detector on recordings without errors."""
    rows = list[list[Value]]()
    for name, recordings in labelled(real):
        balanced, invalid, late, begun = list[float](), 0, 0, 0
        for limit in (inf, Zero.spike):
            right: tuple[list[bool], list[bool]] = ([], [])  # static, slip
            for touch, label in recordings:
                zero, waited = Zero(spike=limit), list[int]()
                parts = [zero.push(touch[:100])]
                for row in range(100, len(touch)):
                    parts.append(zero.push(touch[row : row + 1]))
                    waited += [row] if not len(parts[-1]) else []
                zeroed = concat(Zeroed, [*parts, zero.flush()])
                scores = Score(load_detector("tcn")).push(zeroed)
                slip = scores.probability >= DEBOUNCE.threshold
                for truth in (0, 1):
                    right[truth].extend((slip == truth)[label[-len(slip) :] == truth].tolist())
                invalid += int((~zeroed.valid).sum())
                starts = slips(zeroed)
                at = starts.time[starts.state == SLIP]
                begun += len(at) if limit < inf else 0
                late += int(np.isin(at, touch.time[waited]).sum())
            balanced.append(100 * float(np.mean([np.mean(hits) for hits in right])))
        rows.append([name, *balanced, invalid, begun, 10 * late / max(begun, 1)])
    names = ["balanced %", "with the test", "readings removed", "onsets", "mean delay, ms"]
    return Table(["recordings", *names], rows)


def main() -> None:
    """Print the tables."""
    options = ArgumentParser(description=__doc__)
    options.add_argument("--real", type=Path, help="folder with real strokes and grasps, Parquet")
    given = options.parse_args()
    print(f"commit {commit()}\n\n{prevented().markdown()}\n\n{cost(given.real).markdown()}")


if __name__ == "__main__":
    main()
