"""Training of the grasp detector, on simulated grasps and strokes: `slipflow experiment learn`."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np

from connectors.sim.paper_plan import PaperPlan, varied
from connectors.sim.physics_parameters import Parameters
from flows.lab.experiments.grasp_recordings import grasp_recordings
from flows.learn.labelled_recordings import LabelledRecording, by_split, labelled_by, simulated_recordings
from flows.learn.onsets import runs
from flows.learn.train_extra import require_train_extra
from flows.learn.training.learning_curve import Check
from flows.learn.training.recipe import Recipe
from flows.learn.training.trained_model import Model, label_scores, write_model
from operators.batch import SLIP, UNKNOWN, Codes, Counts
from operators.detectors import GraspTcn
from operators.errors import ParameterError
from operators.software import software_version

GRASPS: Final = 4000  # recordings of up to 5 s
STROKES: Final = PaperPlan(repeats=3, rotations=2, parameters=Parameters(noise=0.6))  # 44 recordings
RECIPE: Final = Recipe(filters=24, steps=2600, batch=40, crop=412)
THRESHOLD: Final = 0.79  # of a slip decision; chosen on other seeds than the reported ones
LASTS: Final = 6  # samples, shortest slip in training: a slip of 20 ms ends before it can be detected
FADES: Final = 6  # samples with unknown label after a lengthened slip
FLOORED: Final = 2  # floored cells from which a recording counts as hard
REPEATS: Final = 3  # further repetitions of the hard parts of a recording
RINGS: Final = 20  # samples after a slip that are not repeated; the rest of the second is
_SPLIT_CYCLE: Final = 10  # recordings of strokes; of these one is for validation, one for the test
_SECOND: Final = 100  # samples
_LOW: Final = -200  # counts; cells floor at 420 to 502 below rest, loaded ones stay higher


def learn(
    out: Path,
    *,
    seed: int = 7000,
    grasps: int = GRASPS,
    strokes: PaperPlan = STROKES,
    recipe: Recipe = RECIPE,
    log: Callable[[str], object] = lambda _: None,
    progress: Callable[[int, int, Check | None], object] = lambda _done, _all, _check: None,
) -> Model:
    """Train the network on grasps and strokes, labelled by true sliding.

    Args:
        out: Model file, .safetensors; its card is the .json next to it.
        seed: Random seed of all recordings.
        grasps: Number of recordings of grasps.
        strokes: Plan of strokes, simulated as it is and with varied scenes.
        recipe: Training recipe of the network.
        log: Called with each step of the work.
        progress: Called with the steps done, their total, and the newest check.

    Raises:
        ParameterError: if `out` does not end in .safetensors, or there are too few recordings.
        InputError: if the train extra is missing.
        OSError: if the model cannot be written.
    """
    require_train_extra("learn")
    if out.suffix != ".safetensors":
        raise ParameterError("learn", "out", str(out), "a path that ends in .safetensors")
    log(f"simulating {grasps} grasps and two plans of strokes")
    kinds = {
        "grasps": list(grasp_recordings(grasps, seed)),
        "strokes": _split(simulated_recordings(strokes, seed + 1)),
        "varied strokes": _split(simulated_recordings(replace(strokes, vary=varied), seed + 2)),
    }
    lengthened_grasps = [replace(each, label=lengthened(each.label)) for each in kinds["grasps"]]
    training = {**kinds, "grasps": lengthened_grasps}
    parts = by_split(chain.from_iterable(training.values()))
    hard = [
        replace(recording, label=hard_parts(recording.label))
        for recording in parts["train"]
        if floored_cells(recording.counts) >= FLOORED
    ]
    from flows.learn.training.dense_training import train_dense  # noqa: PLC0415 - imports torch

    trained = train_dense(
        parts["train"] + hard * REPEATS,
        parts["validation"],
        recipe,
        progress,
    )
    card = {
        **_data_card(kinds, seed),
        "seed": recipe.seed,
        "recipe": asdict(recipe),
        "scores": {
            kind: label_scores(GraspTcn(trained.arrays), [each for each in found if each.split == "test"])
            for kind, found in kinds.items()
        },
        "debounce": {"threshold": THRESHOLD, "consecutive": 2, "release": 5},
        "curve": [asdict(check) for check in trained.curve],
    }
    return write_model(out, trained.arrays, card, trained.curve)


def _data_card(kinds: dict[str, list[LabelledRecording]], seed: int) -> dict[str, Any]:
    """Return the part of the model card about the training data."""
    return {
        "detector": GraspTcn.name,
        "software": f"slipflow {software_version()}",
        "data": [
            {
                "simulated": kind,
                "seed": seed + number,
                "recordings": dict(Counter(recording.split for recording in found)),
                "samples": sum(map(len, found)),
            }
            for number, (kind, found) in enumerate(kinds.items())
        ],
        "target": "sliding",
        "label": "true sliding above 3 mm/s; sticks shorter than 50 ms (strokes: 150 ms) count as slip",
    }


def lengthened(label: Codes, least: int = LASTS, fades: int = FADES) -> Codes:
    """Lengthen each slip in labels (n,) to `least` samples; `fades` samples after a short one become unknown.

    A blow moves an object for 20 to 40 ms, which ends before the signal differs from that of a harmless blow.
    If the next sample were labelled static, the network would learn ambiguous scores for both.

    >>> lengthened(np.array([0, 1, 0, 0, 0, 0], np.int8), least=3, fades=1)
    array([ 0,  1,  1,  1, -1,  0], dtype=int8)
    """
    longer = label.copy()
    for first, end in runs(label == SLIP).tolist():
        longer[end : first + least] = SLIP
        fading = slice(max(end, first + least), first + least + fades)
        longer[fading][label[fading] != SLIP] = UNKNOWN
    return longer


def hard_parts(label: Codes) -> Codes:
    """Return labels (n,) of the parts that floored cells make hard, the rest unknown.

    These are short slips, and the static second after a slip, in which the gripper still vibrates.

    >>> hard_parts(np.array([0, 1, 1, *[0] * 120], np.int8)).tolist().count(0)
    80
    """
    chosen = np.full_like(label, UNKNOWN)
    for first, end in runs(label == SLIP).tolist():
        after = slice(end + RINGS, end + _SECOND)
        chosen[after] = label[after]
        if end - first <= LASTS + 2:
            chosen[first:end] = SLIP
    return chosen


def floored_cells(counts: Counts) -> int:
    """Count the cells of zeroed counts (n, 6) that stay at their floor for a second, without a signal.

    >>> floored_cells(np.repeat(np.array([[-450, -450, -40, 0, 0, 0]], np.int16), 100, axis=0))
    2
    """
    least = counts.min(axis=0)  # (6,)
    return int((((counts == least).sum(axis=0) >= _SECOND) & (least < _LOW)).sum())


def _split(recordings: Sequence[LabelledRecording]) -> list[LabelledRecording]:
    """Label recordings by true sliding and assign their splits in turn."""
    roles = {0: "validation", 1: "test"}
    return [
        replace(recording, split=roles.get(number % _SPLIT_CYCLE, "train"))
        for number, recording in enumerate(labelled_by("sliding", recordings))
    ]
