"""What `Follow` does to drift, to temperature and to presses, next to `Zero`.

--real FOLDER adds recordings of real barometers that a rig presses and holds (the recipe ``barometers``).
"""

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from typing import Final, TypeAlias

import numpy as np
import polars as pl

from connectors.sim.finger import Finger, simulate_scene
from connectors.sim.paper_plan import PaperPlan
from connectors.sim.scene import Faults, Move, Scene, Vibration
from flows.lab.simulation import planned_recordings
from flows.learn.evaluation.event_metrics import performances
from flows.learn.labelled_recordings import LabelledRecording, simulated_recording
from flows.learn.onsets import match_onsets, runs
from flows.learn.scoring import probabilities
from operators import SLIP, Debounce, Follow, Score, Touch, Truth, Zero, Zeroed, concat, s
from operators.batch import Counts, Reals
from operators.forward_fill import forward_fill
from storage import load_debounce, load_detector
from tests.benchmarks.machine import commit, machine

Baseline: TypeAlias = Zero | Follow
BASELINES: Final[dict[str, Callable[[], Baseline]]] = {"Zero": Zero, "Follow": Follow}
DETECTORS: Final = ("tcn", "paper_tcn")
DRIFTS: Final = (0.0, 2.0, 6.0, 20.0, 30.0, -2.0, -6.0, -20.0, -30.0)  # counts/s
SMALL: Final = PaperPlan(repeats=1, rotations=1)  # 16 recordings, 5 minutes, as in `slipflow stress`
PASCAL: Final = 125.5  # per count of an MPL115A2
PER_DEGREE: Final = -5.35  # counts of temperature per K; datasheet
HOPS: Final = {"tcn": 1, "paper_tcn": 10}  # samples, in the long run


def zeroed(touch: Touch, make: Callable[[], Baseline]) -> Zeroed:
    """Return touch without its baseline."""
    baseline = make()
    return concat(Zeroed, [baseline.push(touch), baseline.flush()])


def detected(scenes: Iterable[tuple[Scene, int]]) -> list[float]:
    """Return balanced accuracy (%) and false alarms per static minute of each detector and baseline."""
    recordings = dict[str, list[LabelledRecording]]((name, []) for name in BASELINES)
    for scene, seed in scenes:
        recording, (touch, _, _) = simulated_recording(scene, seed), simulate_scene(scene, seed)
        for name, make in BASELINES.items():
            found = zeroed(touch, make)
            counts = forward_fill(found.counts, found.valid)
            recordings[name].append(replace(recording, counts=counts, valid=found.valid))
    row = list[float]()
    for name in DETECTORS:
        detector, debounce = load_detector(name), load_debounce(name) or Debounce()
        for own in recordings.values():
            scores = [probabilities(detector, each) for each in own]
            of = performances(own, scores, debounce)["arm-speed"]
            row += [of.balanced, of.false_alarms_per_min]
    return row


def drifting() -> None:
    """Print the table of drifts."""
    print("\nDrift of all cells, small plan, seed 4000: balanced accuracy, % (false alarms / static min)\n")
    head(["counts/s", *(f"{detector}, {name}" for detector in DETECTORS for name in BASELINES)])
    for drift in DRIFTS:
        scenes = [
            (replace(scene, faults=Faults(drift=(drift,) * 6)), seed_of(4000, number))
            for number, scene in enumerate(SMALL.scenes(4000))
        ]
        show(f"{drift:+g}", detected(scenes))


def nominal() -> None:
    """Print the row of the paper's plan."""
    print("\nPaper's plan, seed 0, test split: balanced accuracy, % (false alarms / static min)\n")
    head(["drift", *(f"{detector}, {name}" for detector in DETECTORS for name in BASELINES)])
    planned = [each for each in planned_recordings("paper", 0) if each.split == "test"]
    show("none", detected((each.scene, each.seed) for each in planned))


def pressing() -> None:
    """Print what is lost of presses without vibration."""
    print("\nPress to 60 counts after 20 s in air, then held for 60 s, quiet: counts lost at its end\n")
    head(["counts/s", *BASELINES])
    noise = 0.6 * np.random.default_rng(0).standard_normal((100 * 1000, 6))
    for rate in (0.1, 0.2, 0.3, 0.4, 0.5, 1.0, 3.0, 10.0, 100.0):
        t = np.arange(round(100 * (80 + 60 / rate))) / 100
        press = -np.clip((t - 20) * rate, 0, 60)
        touch = touch_of(t, 450 + press[:, None] + noise[: len(t)])
        lost = [60 + zeroed(touch, make).counts[-100:].mean() for make in BASELINES.values()]
        print(f"| {rate:g} | " + " | ".join(f"{each:.1f}" for each in lost) + " |")


def relaxing(folder: Path) -> None:
    """Print what happens to real presses, scaled to the counts of an MPL115A2."""
    print("\nReal barometers, holds of 8 and 20 s: relaxation of the pressed cell from the first to the last")
    print("second of a hold; mean absolute reading in air, 2 s or more after a release; counts\n")
    head(["recording", *(f"{what}, {name}" for what in ("relaxation", "in air") for name in BASELINES)])
    for path in sorted(folder.glob("*_t[28]*_*.parquet")):
        table = pl.read_parquet(path).drop_nulls()
        t, depth = table["time"].to_numpy(), np.abs(table["z"].to_numpy())
        cells = table.select(f"Sensor_{cell}" for cell in range(4)).to_numpy()
        touch = touch_of(t, (cells[0] - cells) / PASCAL)
        found = [held(t, depth, zeroed(touch, make).counts.astype(float)) for make in BASELINES.values()]
        row = " | ".join(f"{each:.1f}" for measure in zip(*found, strict=True) for each in measure)
        print(f"| {path.stem.rsplit('_2023', 1)[0]} | {row} |")


def held(t: Reals, depth: Reals, counts: Reals) -> tuple[float, float]:
    """Return the mean relaxation of the pressed cell in holds, and the mean absolute count in air."""
    changes = list[float]()
    for first, last in runs(depth >= depth.max() - 0.01 * np.ptp(depth)):
        if t[last - 1] - t[first] > 6:
            cell = counts[first:last, np.argmin(counts[first:last].mean(axis=0))]
            at = t[first:last] - t[first]
            changes.append(float(cell[at > at[-1] - 1].mean() - cell[at < 1].mean()))
    air = np.zeros(len(t), np.bool_)  # up to a tenth of the depth
    for first, last in runs(depth <= 0.1 * depth.max()):
        air[first:last] = t[first:last] > t[first] + 2
    return float(np.mean(changes)), float(np.abs(counts[air]).mean())


@dataclass(frozen=True)
class Shift:
    """Grasps for a long time: air, a hold in a vibrating hand, and in some a stroke at its end."""

    seconds: float

    def moves(self, random: np.random.Generator) -> Iterator[Move]:
        """Yield the moves."""
        yield Move("hold", 2.0, force=0.0)
        done = 2.0
        while done < self.seconds:
            air, grasp = random.uniform([3, 10], [10, 50])
            force = 2.0 * float(np.exp(0.3 * random.standard_normal()))
            yield Move("hold", float(grasp), force=force)
            yield Move("translation", 1.1, 0.5, 45.0 * int(random.integers(8)), 0.05)
            yield Move("hold", 1.0)
            yield Move("hold", float(air), force=0.0)
            done += air + grasp + 2.1


def working(minutes: int) -> None:
    """Print a long run with a changing temperature."""
    scene = Scene(Shift(60.0 * minutes), vibration=Vibration())
    finger = Finger(scene, 1)
    taken = list(iter(lambda: finger.take(3000), None))
    steady, truth = concat(Touch, [touch for touch, _ in taken]), concat(Truth, [each for _, each in taken])
    t = steady.time / s
    random = np.random.default_rng(2)
    degrees = 10 * (1 - np.exp(-t / 600)) + 2 * np.sin(2 * np.pi * t / 1800)  # K: warm-up, air conditioning
    per_count, creep = random.normal(-0.3, 0.08, 6), random.choice([-1, 1], 6) * 0.2 / 60
    warmth = PER_DEGREE * degrees[:, None]
    drift = warmth * per_count + t[:, None] * creep
    warm = replace(
        steady,
        counts=np.rint(steady.counts + drift).astype(np.int16),
        temperature=np.rint(steady.temperature + warmth).astype(np.int16),
    )
    kelvin, most = np.ptp(degrees), np.abs(drift).max()
    print(f"\n{minutes} simulated minutes of grasps while the temperature changes by {kelvin:.0f} K")
    print(f"({most:.0f} counts of drift; each grasp ends with a stroke at 50 mm/s)\n")
    head(
        [
            "temperature",
            "baseline",
            "error, counts",
            "at most",
            *(f"{name}: {what}" for name in DETECTORS for what in ("false alarms / h", "missed, %")),
        ]
    )
    for name, touch in (("constant", steady), ("changes", warm)):
        for baseline, make in BASELINES.items():
            found = zeroed(touch, make)
            error = np.abs(found.counts - (steady.counts - np.median(steady.counts[:100], axis=0)))
            cells = [f"{error.mean():.2f}", f"{error.max():.0f}"]
            for detector in DETECTORS:
                cells += [f"{each:.1f}" for each in alarms(found, truth, detector)]
            print(f"| {name} | {baseline} | " + " | ".join(cells) + " |", flush=True)


def alarms(found: Zeroed, truth: Truth, name: str) -> tuple[float, float]:
    """Return false alarms per static hour and missed slides, %."""
    hop = HOPS[name]
    scores = Score(load_detector(name), hop).push(found)
    slips = (load_debounce(name) or Debounce()).push(scores)
    slides = runs(np.convolve(truth.sliding > 0.003, np.ones(20), "same") > 0)  # stick-slip is one slide
    at = np.stack([truth.time[slides[:, 0]], truth.time[slides[:, 1] - 1]], axis=1)
    strokes = at[np.diff(at)[:, 0] > 0.4 * s]  # shorter ones, at a press or release, need not be detected
    onsets = slips.time[slips.state == SLIP]
    static = (found.time[-1] - found.time[0] - np.diff(at).sum()) / (3600 * s)
    missed = match_onsets(onsets, strokes).missed
    return match_onsets(onsets, at).false / static, 100 * missed / len(strokes)


def cost() -> None:
    """Print CPU time per sample."""
    touch = touch_of(np.arange(20_000) / 100, np.random.default_rng(0).normal(450, 0.6, (20_000, 6)))
    rows = [touch[row : row + 1] for row in range(len(touch))]
    print("\nCPU time per sample of six cells, us: one at a time, all in one batch\n")
    head(["baseline", "live", "replay"])
    for name, make in BASELINES.items():
        live, replay = make(), make()
        make().push(touch)  # compiles
        began = process_time()
        for row in rows:
            live.push(row)
        middle = process_time()
        replay.push(touch)
        each = 1e6 * (middle - began) / len(rows), 1e6 * (process_time() - middle) / len(rows)
        print(f"| {name} | {each[0]:.1f} | {each[1]:.2f} |")


def touch_of(t: Reals, counts: Reals) -> Touch:
    """Return touch with readings (n, cells) at t (n,) (s)."""
    whole: Counts = np.rint(counts).astype(np.int16)
    return Touch(np.rint(t * s).astype(np.int64), whole, 0 * whole, np.ones(whole.shape, np.bool_))


def seed_of(seed: int, number: int) -> int:
    """Return the seed of a recording, as `simulated_recordings` draws it."""
    return int(np.random.SeedSequence([seed, number]).generate_state(1)[0])


def head(columns: Sequence[str]) -> None:
    """Print the head of a table."""
    print("| " + " | ".join(columns) + " |")
    print("|" + " ---: |" * len(columns), flush=True)


def show(name: str, row: Sequence[float]) -> None:
    """Print balanced accuracies with false alarms."""
    cells = [f"{row[i]:.1f} ({row[i + 1]:.1f})" for i in range(0, len(row), 2)]
    print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


def main() -> None:
    """Print the tables."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--minutes", type=int, default=200)
    options.add_argument("--real", type=Path)
    options.add_argument("--only", choices=("cost", "press", "real", "nominal", "drift", "long"))
    given = options.parse_args()
    print(f"{machine()}, commit {commit()}")
    if given.only in {None, "cost"}:
        cost()
    if given.only in {None, "press"}:
        pressing()
    if given.only in {None, "real"}:
        if given.real:
            relaxing(given.real)
        else:
            print("\nskipped: real barometers (--real FOLDER)")
    if given.only in {None, "nominal"}:
        nominal()
    if given.only in {None, "drift"}:
        drifting()
    if given.only in {None, "long"}:
        working(given.minutes)


if __name__ == "__main__":
    main()
