"""A detector that has learnt from grasps as well as from strokes: `slipflow experiment learn`."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np

from connectors.sim.paper_plan import Collection
from connectors.sim.physics_parameters import Parameters
from connectors.sim.truth import STICK
from connectors.sim.variety import varied
from flows.lab.experiments.grasp_recordings import by_sliding, handled
from flows.learn.labelled_recordings import LabelledRecording, by_split, simulated_recordings
from flows.learn.onsets import runs
from flows.learn.training.learning_curve import Check
from flows.learn.training.recipe import Recipe
from flows.learn.training.trained_model import Model, label_scores, write_model
from operators.batch import SLIP, UNKNOWN, Codes, Counts
from operators.detectors import GraspTcn
from operators.errors import ParameterError

GRASPS: Final = 4000  # recordings, of up to 5 s
STROKES: Final = Collection(repeats=3, rotations=2, parameters=Parameters(noise=0.6))  # 44 recordings
RECIPE: Final = Recipe(filters=24, steps=2600, batch=40, crop=412)
THRESHOLD: Final = 0.79  # of a slip decision; chosen on trials of other seeds than those that are reported
LASTS: Final = 6  # samples that a slip lasts at least, as learnt: one of 20 ms is over before it is felt
FADES: Final = 6  # samples behind so short a slip of which nobody says what they are
FLOORED: Final = 2  # cells that read their least for a second: from so many on a recording is a hard one
AGAIN: Final = 3  # times that what is hard in one is learnt from once more
RINGS: Final = 20  # samples behind a slip that are not asked for once more; those up to a second are
_VALIDATES: Final = 10  # every so many recordings one validates, and the next tests
_SECOND: Final = 100  # samples
_LOW: Final = -200  # counts; cells floor 420 to 502 below their rest, what is loaded stands higher


def learn(
    out: Path,
    *,
    seed: int = 7000,
    grasps: int = GRASPS,
    strokes: Collection = STROKES,
    recipe: Recipe = RECIPE,
    log: Callable[[str], object] = lambda _: None,
    progress: Callable[[int, int, Check | None], object] = lambda _done, _all, _check: None,
) -> Model:
    """Train our network on grasps and strokes, all labelled by what truly slides.

    Args:
        out: The model file, .safetensors; its card stands beside it as .json.
        seed: Of all recordings.
        grasps: How many recordings of grasps.
        strokes: The plan of strokes; it is simulated once as it is, and once with varied scenes.
        recipe: Of the network.
        log: Called with each step of the work.
        progress: Told how far the training is.

    Raises:
        ParameterError: if `out` does not end in .safetensors, or there are too few recordings.
        InputError: if torch is not installed.
        OSError: if the model cannot be written.
    """
    if out.suffix != ".safetensors":
        raise ParameterError("learn", "out", str(out), "a path that ends in .safetensors")
    log(f"simulating {grasps} grasps and two plans of strokes")
    kinds = {
        "grasps": list(handled(grasps, seed)),
        "strokes": _split(simulated_recordings(strokes, seed + 1)),
        "varied strokes": _split(simulated_recordings(replace(strokes, vary=varied), seed + 2)),
    }
    learnt = {**kinds, "grasps": [replace(t, label=lasting(t.label)) for t in kinds["grasps"]]}
    parts = by_split(chain.from_iterable(learnt.values()))
    hard = [
        replace(trial, label=hardest(trial.label))
        for trial in parts["train"]
        if floored(trial.counts) >= FLOORED
    ]
    from flows.learn.training.dense_training import train_dense  # noqa: PLC0415 - imports torch

    trained = train_dense(
        parts["train"] + hard * AGAIN,
        parts["validation"],
        recipe,
        checkpoint=out.with_name(f"{out.stem}.checkpoint.safetensors"),
        progress=lambda done, check: progress(done, recipe.steps, check),
    )
    detector = GraspTcn(trained.arrays)
    card: dict[str, Any] = {
        "detector": GraspTcn.name,
        "software": f"slipflow {version('slipflow')}",
        "data": [
            {
                "simulated": kind,
                "seed": seed + number,
                "recordings": dict(Counter(trial.split for trial in found)),
                "samples": sum(map(len, found)),
            }
            for number, (kind, found) in enumerate(kinds.items())
        ],
        "label": "true sliding above 3 mm/s; sticks of less than 50 ms (strokes: 150 ms) are a part of it",
        "seed": recipe.seed,
        "recipe": asdict(recipe),
        "scores": {
            kind: label_scores(detector, [trial for trial in found if trial.split == "test"])
            for kind, found in kinds.items()
        },
        "debounce": {"threshold": THRESHOLD, "consecutive": 2, "release": 5},
        "curve": [asdict(check) for check in trained.curve],
    }
    return write_model(out, trained.arrays, card, trained.curve)


def lasting(label: Codes, least: int = LASTS, fades: int = FADES) -> Codes:
    """Labels (n,) in which each slip lasts `least` samples; what follows a short one is unknown.

    A blow moves an object within 20 to 40 ms: that is over before the cells tell it from a harmless one.
    A network that has to call the next sample static again learns to be unsure of both.

    >>> lasting(np.array([0, 1, 0, 0, 0, 0], np.int8), least=3, fades=1)
    array([ 0,  1,  1,  1, -1,  0], dtype=int8)
    """
    longer = label.copy()
    for first, end in runs(label == SLIP).tolist():
        longer[end : first + least] = SLIP
        fading = slice(max(end, first + least), first + least + fades)
        longer[fading][label[fading] != SLIP] = UNKNOWN
    return longer


def hardest(label: Codes) -> Codes:
    """Labels (n,) of what a network with floored cells gets wrong, the rest unknown.

    These are short slips, and the rest behind a slip, where the shaking hand goes on.

    >>> hardest(np.array([0, 1, 1, *[0] * 120], np.int8)).tolist().count(0)
    80
    """
    chosen = np.full_like(label, UNKNOWN)
    for first, end in runs(label == SLIP).tolist():
        behind = slice(end + RINGS, end + _SECOND)
        chosen[behind] = label[behind]
        if end - first <= LASTS + 2:
            chosen[first:end] = SLIP
    return chosen


def floored(counts: Counts) -> int:
    """How many cells of zeroed counts (n, 6) stood at their floor for a second: these feel nothing there.

    >>> floored(np.repeat(np.array([[-450, -450, -40, 0, 0, 0]], np.int16), 100, axis=0))
    2
    """
    least = counts.min(axis=0)  # (6,)
    return int((((counts == least).sum(axis=0) >= _SECOND) & (least < _LOW)).sum())


def _split(trials: Sequence[LabelledRecording]) -> list[LabelledRecording]:
    """Labelled by their true sliding; recordings take turns at the splits."""
    roles = {0: "validation", 1: "test"}
    return [
        replace(trial, label=_label(trial), split=roles.get(number % _VALIDATES, "train"))
        for number, trial in enumerate(trials)
    ]


def _label(trial: LabelledRecording) -> Codes:
    assert trial.sliding is not None, "simulated trials know it"
    return by_sliding(trial.sliding, STICK)
