"""Study: does the distance of the TCN's features from those of its training data tell when it is wrong?

The weights contain the fit: training computes it from its train split and the limit, a quantile of 99 %, from
its validation split. It has seen neither the stresses nor the seed that they are judged by.
Balanced accuracies are against the label by arm speed and against true sliding.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from flows.learn.labelled_recordings import WARM_UP, LabelledRecording, simulated_recordings
from flows.learn.scoring import probabilities
from flows.learn.stress.stress_fields import FIELDS, plan_of, stressed
from flows.learn.stress.stress_study import PLAN
from flows.learn.training.familiarity_fit import distances
from operators.batch import SLIP, UNKNOWN, Codes, Flags
from operators.detectors import Tcn
from storage import load_detector
from tests.benchmarks.machine import commit, machine

JUDGED: Final = 5_000  # seed of the stresses; the score and its mean were chosen with seed 4000
WEAK: Final = 85.0  # %, balanced accuracy below which most samples should be doubtful


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


def conditions(tcn: Tcn, doubtful: Callable[[LabelledRecording], Flags], seed: int) -> Iterator[Condition]:
    """Yield nominal, then every stress."""
    nominal = next(iter(FIELDS))
    chosen = [(nominal, FIELDS[nominal].nominal)]
    chosen += [(field, value) for field, each in FIELDS.items() for value in each.values[1:]]
    for number, (field, value) in enumerate(chosen):
        plan = plan_of(field, PLAN)
        found = simulated_recordings(plan, seed, partial(stressed, field=field, value=value))
        score = np.concatenate([probabilities(tcn, each)[WARM_UP:] for each in found])
        sliding = [each.label if each.sliding is None else each.sliding for each in found]
        yield Condition(
            f"{FIELDS[field].text} {FIELDS[field].show(value)}" if number else "nominal",
            np.concatenate([doubtful(each) for each in found]),
            ~np.isnan(score),
            score > 0.5,
            (_joined([each.label for each in found]), _joined(sliding)),
        )


def _joined(labels: Sequence[Codes]) -> Codes:
    return np.concatenate([each[WARM_UP:] for each in labels])


def report(found: Sequence[Condition]) -> None:
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


def main() -> None:
    """Judge the familiarity that a network's weights contain, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", default="tcn", help="shipped tcn or file of weights")
    parser.add_argument("--seed", type=int, default=JUDGED, help="seed of the stresses")
    given = parser.parse_args()
    tcn = load_detector(given.model)
    assert isinstance(tcn, Tcn)
    familiarity = tcn.heads.familiarity
    assert familiarity is not None, "train the model again"

    def doubtful(recording: LabelledRecording) -> Flags:
        return distances(tcn, familiarity, recording) > familiarity.limit

    print(f"{machine()}; {commit()}; {given.model}; seed {given.seed}")
    report(list(conditions(tcn, doubtful, given.seed)))


if __name__ == "__main__":
    main()
