"""Study: do the doubt about the input and the direction of sliding of the shipped tcn say what they should?

Doubt: nominal recordings, then every stress, with a seed that no fit has seen. A sample is doubtful if its
doubt is above 1. Balanced accuracies are against the label by arm speed and against true sliding.

Direction: at the onsets of the debounced events in nominal recordings, against the mean true velocity of the
following 0.2 s.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from connectors.sim.finger import Finger
from connectors.sim.paper_plan import PaperPlan
from connectors.sim.simulated_rig import SimulatedRig
from flows.learn.labelled_recordings import LabelledRecording, load, simulated_recordings
from flows.learn.sampling import WARM_UP
from flows.learn.scoring import assessed
from flows.learn.stress.stress_fields import FIELDS, plan_of, stressed
from flows.learn.stress.stress_study import PLAN
from operators import Score, Zero
from operators.batch import DOUBTFUL, SLIP, UNKNOWN, Assessed, Codes, Flags
from operators.debounce import Debounce
from operators.detectors import Detector
from storage import load_debounce, load_detector
from tests.benchmarks.machine import commit, machine

JUDGED: Final = 5_000  # seed
ONSETS: Final = PaperPlan(repeats=3, rotations=1)  # 40 recordings
WEAK: Final = 85.0  # %, balanced accuracy below which most samples should be doubtful
RIGHT: Final = 45.0  # degrees
FOLLOWING: Final = 20  # samples
MINUTES: Final = 10
MINUTE: Final = 6000  # samples


@dataclass(frozen=True)
class Condition:
    """Samples under one stress."""

    name: str
    doubtful: Flags
    scored: Flags
    decision: Flags
    labels: tuple[Codes, Codes]  # by arm speed; by true sliding

    def balanced(self, target: int) -> float:
        """Return the balanced accuracy of the scored samples, %; NaN if there are none."""
        label = self.labels[target]
        of = [self.decision[self.scored & (label == value)] == bool(value) for value in (SLIP, 0)]
        return 50 * sum(float(each.mean()) for each in of) if all(map(len, of)) else float("nan")

    def right(self, target: int, chosen: Flags) -> Flags:
        """Return whether each chosen and scored sample with a label is right."""
        label = self.labels[target]
        known = chosen & self.scored & (label != UNKNOWN)
        right: Flags = self.decision[known] == (label[known] == SLIP)
        return right


def conditions(detector: Detector, seed: int) -> Iterator[Condition]:
    """Yield nominal, then every stress."""
    nominal = next(iter(FIELDS))
    chosen = [(nominal, FIELDS[nominal].nominal)]
    chosen += [(field, value) for field, each in FIELDS.items() for value in each.values[1:]]
    for number, (field, value) in enumerate(chosen):
        recordings = simulated_recordings(
            plan_of(field, PLAN), seed, partial(stressed, field=field, value=value)
        )
        name = f"{FIELDS[field].text} {FIELDS[field].show(value)}" if number else "nominal"
        yield condition(name, detector, recordings)


def condition(name: str, detector: Detector, recordings: Sequence[LabelledRecording]) -> Condition:
    """Return the samples of recordings; without true sliding the label replaces it."""
    found = [assessed(detector, each) for each in recordings]
    probability = np.concatenate([each.probability[WARM_UP:] for each in found])
    sliding = [each.label if each.sliding is None else each.sliding for each in recordings]
    return Condition(
        name,
        np.concatenate([each.doubt[WARM_UP:] for each in found]) > DOUBTFUL,
        ~np.isnan(probability),
        probability > 0.5,
        (_joined([each.label for each in recordings]), _joined(sliding)),
    )


def _joined(labels: Sequence[Codes]) -> Codes:
    return np.concatenate([each[WARM_UP:] for each in labels])


def report_doubt(found: Sequence[Condition]) -> None:
    """Print the shares and accuracies."""
    print(f"{100 * found[0].doubtful.mean():.2f} % of nominal samples doubtful")
    print(
        "| condition | balanced % | against sliding % | doubtful % | no score % |\n|---|---:|---:|---:|---:|"
    )
    for each in found:
        shares = 100 * each.doubtful.mean(), 100 * (~each.scored).mean()
        row = each.balanced(0), each.balanced(1), *shares
        print(f"| {each.name} | " + " | ".join(f"{value:.1f}" for value in row) + " |")
    for target, text in enumerate(("arm speed", "sliding")):
        weak = [each for each in found if not each.balanced(target) >= WEAK]
        flagged = sum((each.doubtful | ~each.scored).mean() > 0.5 for each in weak)
        good, other = (
            100 * np.concatenate([e.right(target, e.doubtful == flag) for e in found[1:]]).mean()
            for flag in (False, True)
        )
        print(
            f"{text}: most samples doubtful or without score in {flagged} of {len(weak)} conditions below "
            f"{WEAK:g} %; under stress {good:.1f} % right if good, {other:.1f} % if doubtful"
        )


def report_direction(detector: Detector, debounce: Debounce, recordings: Sequence[LabelledRecording]) -> None:
    """Print the errors of the directions at onsets that precede true sliding."""
    errors, deviations = list[float](), list[float]()
    for recording in recordings:
        slips = debounce.reset_copy().push(assessed(detector, recording))
        assert recording.velocity is not None, "these are simulated"
        for row, direction, deviation in zip(
            (slips.time // recording.sampling.period).tolist(),
            slips.direction.tolist(),
            slips.deviation.tolist(),
            strict=True,
        ):
            true = recording.velocity[row : row + FOLLOWING]
            true = true[~np.isnan(true[:, 0])]
            if len(true) and not np.isnan(direction):
                x, y = true.mean(axis=0)
                turn = direction - np.arctan2(y, x)
                errors.append(float(np.degrees(abs(np.angle(np.exp(1j * turn))))))
                deviations.append(float(np.degrees(deviation)))
    error, deviation = np.array(errors), np.array(deviations)
    sure = deviation <= RIGHT
    within, stated = 100 * (error <= RIGHT).mean(), 100 * (error <= deviation).mean()
    print(
        f"direction at {len(error)} onsets: median error {np.median(error):.0f} degrees, {within:.1f} % "
        f"within {RIGHT:g} degrees, {stated:.0f} % within the stated deviation"
    )
    certain = 100 * (error[sure] <= RIGHT).mean()
    print(
        f"with a deviation of at most {RIGHT:g} degrees, {100 * sure.mean():.0f} %: {certain:.1f} % within it"
    )


def report_rig(detector: Detector, seed: int) -> None:
    """Print the share of doubtful samples in the scene of the simulated rig, which is no training plan."""
    doubtful, scene = list[float](), SimulatedRig().scene
    for number in range(MINUTES):
        taken = Finger(scene, seed + number).take(MINUTE)
        assert taken is not None, "it has no end"
        scores = Score(detector).push(Zero().push(taken[0]))
        if isinstance(scores, Assessed):
            doubtful.append(100 * float((scores.doubt > DOUBTFUL).mean()))
    print(
        f"simulated rig, {MINUTES} minutes: {np.mean(doubtful):.1f} % doubtful, {max(doubtful):.1f} % at most"
    )


def main() -> None:
    """Print the results of both."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", default="tcn", help="name or file of the detector")
    parser.add_argument("--seed", type=int, default=JUDGED, help="seed of the recordings")
    parser.add_argument("--strokes", type=Path, help="only judge this dataset of another fingertip")
    given = parser.parse_args()
    model: str = given.model
    detector = load_detector(model)
    print(f"{machine()}; {commit()}; seed {given.seed}")
    if given.strokes:
        real = condition(given.strokes.name, detector, load(given.strokes))
        doubtful = 100 * real.doubtful.mean()
        print(f"{real.name}: balanced accuracy {real.balanced(0):.1f} %, {doubtful:.1f} % doubtful")
        return
    report_doubt(list(conditions(detector, given.seed)))
    report_rig(detector, given.seed)
    report_direction(detector, load_debounce(model) or Debounce(), simulated_recordings(ONSETS, given.seed))


if __name__ == "__main__":
    main()
