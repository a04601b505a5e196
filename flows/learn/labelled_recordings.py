"""What a detector is trained and judged on: recordings of one fingertip as counts and labels."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from connectors import CsvTrace
from connectors.sim.arm_motion import Controller
from connectors.sim.finger import Finger
from connectors.sim.paper_plan import Collection
from connectors.sim.scene import Move, Scene, Timing
from connectors.sim.truth import SLIDING, Truth
from flows.learn.splits import SPLITS, TURNS
from operators import Align, Health, Label, Zero, ms
from operators.batch import (
    BAROMETERS,
    SLIP,
    UNKNOWN,
    Codes,
    Counts,
    Faults,
    Flags,
    Labelled,
    Motion,
    Reals,
    Touch,
    concat,
    s,
)
from operators.errors import InputError
from operators.forward_fill import forward_fill
from storage import Session
from storage.layout import session_folder, session_names

JUDGED: Final = 99  # samples before the first that is judged: what the longest window needs
_STRETCH: Final = 3000  # samples simulated at once
_STROKES: Final = ("translation", "rotation")


@dataclass(frozen=True, slots=True, eq=False)
class LabelledRecording:
    """One recording of one fingertip at 100 Hz."""

    counts: Counts  # (n, 6) zeroed; a cell that did not answer reads what it read last, as `Score` has it
    label: Codes  # (n,) by the arm's speed, as the paper labels: 1 slip, 0 static, -1 unknown
    surface: str  # plane, sphere, cylinder_x or cylinder_y; of a trace, its material
    speed: float | None = None  # m/s of its strokes; None: rotations
    oblique: Flags | None = None  # (n,) whether the latest stroke crosses both axes of the fingertip
    valid: Flags | None = None  # (n, 6) False where a cell did not answer; None: all did
    force: Reals | None = None  # (n,) N, normal: the simulation's truth, for the eye only
    sliding: Flags | None = None  # (n,) whether the contact slid: the simulation's truth
    zeroing: int = 0  # samples that it begins with and that the baseline was taken from
    name: str = ""
    split: str = ""  # train, validation or test
    degraded: Flags | None = None  # (n,) whether `Health` reports a barometer at fault; None: not asked

    def __len__(self) -> int:
        return len(self.label)

    @property
    def slip(self) -> Flags:
        """Where the label says slip; (n,)."""
        slip: Flags = self.label == SLIP
        return slip

    def judged(self, hop: int) -> NDArray[np.intp]:
        """The samples that detectors are judged by: each `hop`-th that has a second of signal behind it."""
        return np.arange(JUDGED, len(self), hop)


def simulated_recordings(
    collection: Collection, seed: int, change: Callable[[Scene], Scene] = lambda scene: scene
) -> list[LabelledRecording]:
    """Every recording of a plan; `change` is what becomes of each scene first."""
    return [
        simulated_recording(change(scene), int(np.random.SeedSequence([seed, n]).generate_state(1)[0]))
        for n, scene in enumerate(collection.scenes(seed))
    ]


def simulated_recording(scene: Scene, seed: int, name: str = "", split: str = "") -> LabelledRecording:
    """One scene as the project's own operators see it: zeroed, aligned in event time, labelled by speed."""
    moves: list[tuple[float, Move]] = []
    finger = Finger(scene, seed, begun=lambda move, start: moves.append((start, move)))
    controller = Controller(scene, seed)
    taken = list(iter(lambda: finger.take(_STRETCH), None))
    motion = concat(Motion, list(iter(lambda: controller.take(_STRETCH), None)))
    touch = concat(Touch, [felt for felt, _ in taken])
    truth = _felt(concat(Truth, [happened for _, happened in taken]), touch, scene.touch)
    zero, align, label = Zero(), Align(within=20 * ms), Label(rotation=0.2)
    zeroed = zero.push(touch)
    samples = [align.push(zeroed, motion), align.flush()]
    labelled = concat(Labelled, [label.push(batch) for batch in samples])
    strokes = [(start, move) for start, move in moves if move.motion in _STROKES]
    starts = np.array([start for start, _ in strokes]) * s
    speeds = [move.speed for _, move in strokes if move.motion == "translation"]
    return LabelledRecording(
        _held(labelled),
        labelled.label,
        scene.curvature,
        speeds[0] if speeds else None,
        _latest([move.axis == "oblique" for _, move in strokes], starts, truth.time),
        labelled.valid,
        truth.force,
        truth.sliding > SLIDING,
        zero.scans,
        name,
        split,
        _degraded(touch),
    )


def load(dataset: Path) -> list[LabelledRecording]:
    """Every fingertip of every session of a dataset.

    Where no session says which split it belongs to, as none does that was recorded by hand, they take turns
    in the order of their names: seven of ten train, one validates, two test.

    Raises:
        InputError: if there is no dataset there, a file of it is damaged, or it holds no labelled samples.
    """
    if not dataset.is_dir():
        raise InputError(
            str(dataset), "there is no such folder; `slipflow simulate` or `run record` make one"
        )
    names = session_names(dataset)
    recordings = [
        _of_session(session, finger)
        for session in (Session.open(session_folder(dataset, name)) for name in names)
        for finger in session.fingers(Labelled)
    ]
    if recordings and not any(recording.split for recording in recordings):
        order = {name: number for number, name in enumerate(names)}
        recordings = [
            replace(recording, split=TURNS[order[recording.name] % len(TURNS)]) for recording in recordings
        ]
    if not recordings:
        raise InputError(
            str(dataset), "holds no labelled samples; `slipflow simulate` or `run record` make some"
        )
    return recordings


def by_split(recordings: Iterable[LabelledRecording]) -> dict[str, list[LabelledRecording]]:
    """The recordings of each of `SPLITS`; those of no split are left out."""
    recordings = list(recordings)
    return {split: [each for each in recordings if each.split == split] for split in SPLITS}


def read_trace(path: Path) -> LabelledRecording:
    """A real trace.

    Raises:
        InputError: if it has no labels, or is no trace.
    """
    trace = CsvTrace(path, zeroed=True)
    if (trace.labels == UNKNOWN).any():
        raise InputError(str(path), "has rows without a label; a trace to judge by needs one in each")
    return LabelledRecording(trace.touch.counts, trace.labels, path.stem, name=path.stem)


def _of_session(session: Session, finger: int) -> LabelledRecording:
    labelled = concat(Labelled, list(session.read(Labelled, finger)))
    surface, split, speed, oblique = "", "", None, None
    if "episodes" in session.tables:
        episodes = session.frame("episodes").to_dicts()
        strokes = [each for each in episodes if each["motion"] in _STROKES]
        speeds = [each["speed"] for each in strokes if each["motion"] == "translation"]
        surface, split = (str(episodes[0][key] or "") for key in ("curvature", "split"))
        speed = speeds[0] if speeds else None
        starts = np.array([each["start"] for each in strokes])
        oblique = _latest([each["axis"] == "oblique" for each in strokes], starts, labelled.time)
    return LabelledRecording(
        _held(labelled),
        labelled.label,
        surface,
        speed,
        oblique,
        labelled.valid,
        name=session.name,
        split=split,
    )


def _felt(truth: Truth, touch: Touch, timing: Timing) -> Truth:
    """The truth of the samples that arrived: where some were lost, found by their stamps."""
    if len(truth) == len(touch):
        return truth
    t = (touch.time / s - timing.latency - timing.offset) / (1 + timing.drift)  # (n,) s
    return truth[np.rint(t * timing.rate).astype(np.intp).clip(0, len(truth) - 1)]


def _degraded(touch: Touch) -> Flags:
    """Whether `Health` reports a barometer at fault; (n,)."""
    health = Health()
    faults = concat(Faults, [health.push(touch), health.flush()])
    number = np.concatenate(([0], np.where(faults.active, 1, -1).cumsum()))  # of faults, after each change
    active: Flags = number[faults.time.searchsorted(touch.time, "right")] > 0
    return active


def _held(labelled: Labelled) -> Counts:
    return forward_fill(labelled.counts, labelled.valid, np.zeros(BAROMETERS, np.int16))


def _latest(flags: Sequence[bool], starts: Reals | NDArray[np.int64], time: NDArray[np.int64]) -> Flags:
    """The flag of the stroke that began last before each instant, False before the first; (n,)."""
    return np.array([*flags, False])[np.searchsorted(starts, time, "right") - 1]
