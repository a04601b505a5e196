"""Training of the grasp detector and of the paper's network on grasps: `slipflow experiment learn`."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np

from connectors.sim.paper_plan import PaperPlan, varied
from flows.lab.experiments.grasp_recordings import grasp_recordings
from flows.lab.experiments.rivals import CARDS, DEFAULT, load_rival
from flows.lab.experiments.tuning import Tuned, tune
from flows.learn.labelled_recordings import LabelledRecording, by_split, labelled_by, simulated_recordings
from flows.learn.onsets import runs
from flows.learn.training.learning_curve import Check
from flows.learn.training.recipe import Augmentation, PaperRecipe, Recipe
from flows.learn.training.trained_model import Model, label_scores, write_model
from flows.report.report_page import make_output_folder
from operators.batch import SLIP, UNKNOWN, Codes, Counts
from operators.detectors import Detector, GraspTcn, PaperTcn
from operators.extras import require_extra
from operators.software import software_version
from storage.models import save_card

STROKES: Final = PaperPlan(repeats=3, rotations=2, vary=varied)
AUGMENTATION: Final = Augmentation(  # weaker than for strokes: a box changes its cells by 6 to 10 counts
    gain=0.3, load=0.1, noise_range=(0.3, 5.0), dead=0.1
)
RECIPE: Final = Recipe(filters=24, steps=2600, batch=40, crop=412, augmentation=AUGMENTATION)
PAPER: Final = PaperRecipe(epochs=5)
GRACE: Final = 8  # samples with unknown label from the onset of a short slip, such as by a blow
LONG_GRACE: Final = 20  # the same of a long slip, which begins like the rise of load in a firm grasp
LONG: Final = 30  # samples of a long slip at least
LASTS: Final = 18  # samples from the onset to the end of the shortest slip in training
SPAN: Final = 5  # samples in which a cell of a hard static sample moves
RESTLESS: Final = 8  # counts by which it moves
ONSET: Final = 25  # samples of each slip that are hard
REPEATS: Final = 2  # further repetitions of the hard parts of a grasp
FADES: Final = 8  # samples with unknown label after a lengthened slip
_SPLIT_CYCLE: Final = 10  # recordings of strokes; of these one is for validation, one for the test
_LABEL: Final = "true sliding above 3 mm/s; slides of up to 0.1 mm are static, of up to 0.5 mm unknown"


@dataclass(frozen=True, slots=True)
class Course:
    """Data and recipes of the training."""

    seed: int = 7000  # of the grasps; the strokes have the next one
    grasps: int = 4000  # recordings of up to 5 s
    strokes: PaperPlan = STROKES  # 44 recordings
    recipe: Recipe = RECIPE
    paper: PaperRecipe = PAPER
    trials: int = 200  # that tune the thresholds
    tuning_seed: int = 800_000  # of the first of them


def learn(
    folder: Path,
    course: Course,
    *,
    jobs: int | None = None,
    log: Callable[[str], object] = lambda _: None,
    progress: Callable[[int, int, Check | None], object] = lambda _done, _all, _check: None,
) -> dict[str, Model]:
    """Train both networks on grasps and strokes, labelled by true sliding, and tune all thresholds.

    Writes the models and the cards of all methods that `CARDS` names.

    Args:
        folder: Folder of the models.
        course: Data and recipes.
        jobs: Number of processes that simulate; None: one per core.
        log: Called with each step of the work.
        progress: Called with the steps done, their total, and the newest check.

    Returns:
        The trained models by method.

    Raises:
        ParameterError: if there are too few recordings.
        InputError: if the train extra is missing.
        OSError: if a file cannot be written.
    """
    require_extra("train", "learn")
    from flows.learn.training.dense_training import train_dense  # noqa: PLC0415 - imports torch
    from flows.learn.training.paper_training import train_windowed  # noqa: PLC0415

    log(f"simulating {course.grasps} grasps and a plan of strokes")
    kinds = {
        "grasps": grasp_recordings(course.grasps, course.seed, jobs),
        "strokes": _split(simulated_recordings(course.strokes, course.seed + 1)),
    }
    delayed_grasps = [replace(each, label=delayed(each.label)) for each in kinds["grasps"]]
    parts = by_split(chain(delayed_grasps, kinds["strokes"]))
    hard = [
        replace(each, label=hard_parts(each.counts, each.label)) for each in by_split(delayed_grasps)["train"]
    ]
    log("training our network")
    ours = train_dense(parts["train"] + hard * REPEATS, parts["validation"], course.recipe, progress)
    log("training the paper's network")
    paper = train_windowed("paper_tcn", parts["train"], parts["validation"], course.paper, progress)
    log("tuning the thresholds")
    detectors: dict[str, Detector] = {DEFAULT: GraspTcn(ours.arrays), "paper": PaperTcn(paper.arrays)}
    detectors |= {name: load_rival(name) for name in CARDS if name not in detectors}
    tuned = tune(detectors, course.trials, course.tuning_seed, jobs)
    networks = {DEFAULT: (ours, asdict(course.recipe)), "paper": (paper, asdict(course.paper))}
    about, models = _data_card(kinds, course), dict[str, Model]()
    make_output_folder(folder)
    for name, detector in detectors.items():
        path, card = folder / f"{CARDS[name]}.safetensors", _tuning_card(detector, tuned[name], course)
        if name not in networks:
            save_card(path, card)
            continue
        trained, recipe = networks[name]
        curve = [asdict(check) for check in trained.curve]
        card |= about | {
            "seed": recipe["seed"],
            "recipe": recipe,
            "scores": _scores(detector, kinds),
            "curve": curve,
        }
        models[name] = write_model(path, trained.arrays, card, trained.curve)
    return models


def _tuning_card(detector: Detector, tuned: Tuned, course: Course) -> dict[str, Any]:
    """Return the part of a card that each method has."""
    return {
        "detector": detector.name,
        "software": f"slipflow {software_version()}",
        "debounce": {"threshold": tuned.threshold, "consecutive": 2, "release": 5},
        "tuning": {"trials": course.trials, "seed": course.tuning_seed, **asdict(tuned)},
    }


def _data_card(kinds: dict[str, list[LabelledRecording]], course: Course) -> dict[str, Any]:
    """Return the part of the model card about the training data."""
    return {
        "data": [
            {
                "simulated": kind,
                "seed": course.seed + number,
                "recordings": dict(Counter(recording.split for recording in found)),
                "samples": sum(map(len, found)),
            }
            for number, (kind, found) in enumerate(kinds.items())
        ],
        "target": "sliding",
        "label": _LABEL,
    }


def _scores(detector: Detector, kinds: dict[str, list[LabelledRecording]]) -> dict[str, dict[str, float]]:
    """Return the scores of a detector on the test recordings of each kind."""
    return {
        kind: label_scores(detector, [each for each in found if each.split == "test"])
        for kind, found in kinds.items()
    }


def delayed(label: Codes, least: int = LASTS, grace: int = GRACE, fades: int = FADES) -> Codes:
    """Delay each slip in labels (n,) by `grace` samples and let it last until `least` samples from its onset.

    The `grace` samples, or `LONG_GRACE` of a long slip, and `fades` samples after a slip that was lengthened,
    become unknown. A long slip begins like the rise of load in a firm grasp, and a blow moves an object for
    20 to 40 ms, which ends before the signal differs from that of a harmless blow. With labels by the
    instant, the network would learn ambiguous scores for both.

    >>> import numpy as np
    >>> delayed(np.array([0, 1, 0, 0, 0, 0], np.int8), least=3, grace=1, fades=1)
    array([ 0, -1,  1,  1, -1,  0], dtype=int8)
    """
    late = label.copy()
    for first, end in runs(label == SLIP).tolist():
        late[end : first + least] = SLIP
        fading = slice(max(end, first + least), first + least + fades)
        late[fading][label[fading] != SLIP] = UNKNOWN
        late[first : first + (grace if end - first < LONG else LONG_GRACE)] = UNKNOWN
    return late


def hard_parts(counts: Counts, label: Codes) -> Codes:
    """Return the labels (n,) of what is hard, the rest unknown: static with moving cells, and onsets of slip.

    Most static samples are calm, and most slip samples are in long slides. Both are easy, and without more
    weight for the others, the network would learn little about blows and the rise of load.

    >>> import numpy as np
    >>> hard_parts(np.zeros((60, 6), np.int16), np.array([0] * 20 + [1] * 40, np.int8)).tolist().count(1)
    25
    """
    moved = np.abs(counts[SPAN:].astype(np.intp) - counts[:-SPAN]).max(axis=1) > RESTLESS  # (n - SPAN,)
    restless = np.concatenate((np.zeros(SPAN, np.bool_), moved))
    chosen = np.where(restless | (label == SLIP), label, UNKNOWN).astype(np.int8)
    for first, end in runs(label == SLIP).tolist():
        chosen[first + ONSET : end] = UNKNOWN
    return chosen


def _split(recordings: Sequence[LabelledRecording]) -> list[LabelledRecording]:
    """Label recordings by true sliding and assign their splits in turn."""
    roles = {0: "validation", 1: "test"}
    return [
        replace(recording, split=roles.get(number % _SPLIT_CYCLE, "train"))
        for number, recording in enumerate(labelled_by("sliding", recordings))
    ]
