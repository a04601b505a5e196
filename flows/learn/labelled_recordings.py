"""Labelled recordings: counts and labels of one fingertip, which detectors are trained and evaluated on."""

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from connectors.sim.paper_plan import PaperPlan
from connectors.sim.scene import Scene
from connectors.sim.simulated_rig import SLIDING, SLIDING_SPAN, episode
from operators import Align, Debounce, Label, Score, Zero, ms, s
from operators.batch import (
    EVERY,
    MOTIONS,
    SLIP,
    SURFACES,
    UNKNOWN,
    Codes,
    Counts,
    Episodes,
    Flags,
    Labelled,
    Motion,
    Reals,
    Sample,
    Times,
    Touch,
    Truth,
    Zeroed,
    concat,
)
from operators.detectors import Detector
from operators.errors import FingertipError, InputError
from operators.fingertip import TAKKTILE, Fingertip
from operators.operator import LateRowFilter
from operators.score import forward_fill
from storage import HandLabels, Session
from storage.layout import session_folders

SPLITS: Final = ("train", "validation", "test")
# of recordings without a split, in turn
TURNS: Final = ("train", "train", "test", "train", "validation", "train", "train", "test", "train", "train")
PAPER_LABEL: Final = Label(SLIDING)  # of strokes
_STROKES: Final = ("translation", "rotation")
_ALONG: Final = 1e-6  # largest |sin(2 angle)| of a stroke along an axis of the fingertip
WARM_UP: Final = 99  # samples; the paper's windows have 100
_DIGITS: Final = 12  # of a sha256: enough to tell millions of recordings apart
_REST: Final = 250 * ms  # ns, over which a contact at rest has hardly slid
_GAP: Final = 50 * ms  # ns, longest time between two rows; nothing slides in a longer one
_RATE: Final = 100.0  # Hz, that settings of a debounce and features are written for


@dataclass(frozen=True, slots=True)
class Sampling:
    """Constant rate of samples.

    >>> Sampling(200.0).period, Sampling(200.0).warm_up, Sampling(16.0).warm_up, Sampling(200.0).scaled(2)
    (5000000, 199, 99, 4)
    """

    rate: float = _RATE  # Hz

    @property
    def period(self) -> int:
        """Time from one sample to the next, ns."""
        return round(s / self.rate)

    @property
    def warm_up(self) -> int:
        """Samples at the start that are not evaluated: no window of 1 s and of 100 samples is filled yet."""
        return max(round(self.rate) - 1, WARM_UP)

    def samples(self, time: float) -> int:
        """Return the number of samples in a time (ns), at least 1."""
        return max(round(time * self.rate / s), 1)

    def scaled(self, usual: int) -> int:
        """Return the number of samples that last as long as `usual` ones at 100 Hz; below 100 Hz `usual`."""
        return round(usual * max(self.rate / _RATE, 1))

    def rule(self, usual: Debounce) -> Debounce:
        """Return a debounce that takes as long as `usual` does at 100 Hz; below 100 Hz as many decisions."""
        return Debounce(usual.threshold, self.scaled(usual.consecutive), self.scaled(usual.release))


@dataclass(frozen=True, slots=True, eq=False)
class Strokes:
    """The motions over a surface in a recording."""

    surface: str  # plane, sphere, cylinder_x or cylinder_y
    speed: float | None  # m/s of the translations; None: rotations
    oblique: Flags  # (n,) True if the latest stroke is oblique to the fingertip's axes


@dataclass(frozen=True, slots=True, eq=False)
class LabelledRecording:
    """Samples of one fingertip at a constant rate, with their labels; samples may be lost."""

    counts: Counts  # (n, cells) zeroed; invalid cells hold their last valid value, as in `Score`
    label: Codes  # (n,) by arm speed, as in the paper, or by hand: 1 slip, 0 static, -1 unknown
    valid: Flags | None = None  # (n, cells) False where a cell has no reading; None: all valid
    sliding: Codes | None = None  # (n,) label by true sliding of the contact in simulation
    strokes: Strokes | None = None  # None: unknown
    name: str = ""
    split: str = ""  # train, validation or test
    group: str = ""  # surface or object, by which recordings can be split; empty: unknown
    plan: str = ""  # of a simulation
    fingertip: Fingertip = TAKKTILE
    dataset: str = ""  # path of its folder
    time: Times | None = None  # (n,) ns; None: at the constant rate, without lost samples

    def __len__(self) -> int:
        return len(self.label)

    @property
    def session(self) -> tuple[str, str]:
        """Dataset and session, which the recordings of several fingertips share."""
        return self.dataset, self.name

    @property
    def content(self) -> str:
        """Start of the sha256 of the counts, which a copy under another name shares."""
        return hashlib.sha256(self.counts.tobytes()).hexdigest()[:_DIGITS]

    @property
    def sampling(self) -> Sampling:
        """Rate of the samples, by which all times are computed."""
        return Sampling(self.fingertip.rate)

    @property
    def places(self) -> NDArray[np.int64]:
        """Places of the samples (n,) among regular ones; lost ones leave theirs free, 1 s of them at most."""
        order, sampling = np.arange(len(self)), self.sampling
        if self.time is None:
            return order
        near = np.rint((self.time - self.time[:1]) / sampling.period).astype(np.int64)
        places = np.maximum.accumulate(near - order) + order
        return np.minimum(np.diff(places, prepend=places[:1]), sampling.samples(s)).cumsum()

    @property
    def slip(self) -> Flags:
        """True where the label is slip; (n,)."""
        slip: Flags = self.label == SLIP
        return slip

    def piece(self, rows: slice) -> Self:
        """Return consecutive samples of the recording, without its strokes."""
        return replace(
            self,
            counts=self.counts[rows],
            label=self.label[rows],
            valid=None if self.valid is None else self.valid[rows],
            sliding=None if self.sliding is None else self.sliding[rows],
            strokes=None,
            time=None if self.time is None else self.time[rows],
        )

    def known(self, hop: int) -> NDArray[np.intp]:
        """Return the indices of every `hop`-th sample after the warm-up that has a label."""
        at = np.arange(self.sampling.warm_up, len(self), hop)
        known: NDArray[np.intp] = at[self.label[at] != UNKNOWN]
        return known

    def windows(self, length: int, hop: int) -> Counts:
        """Return the windows (k, length, cells) that end at the `known` samples."""
        ends = self.known(hop)
        if not len(ends):  # the recording may be shorter than a window
            return np.empty((0, length, self.counts.shape[1]), self.counts.dtype)
        view = sliding_window_view(self.counts, length, axis=0)  # (n - length + 1, cells, length)
        windows: Counts = view[ends + 1 - length].transpose(0, 2, 1)
        return windows

    def probabilities(self, detector: Detector) -> Reals:
        """Return the probability of slip at each sample, as `Score` computes it in a live run.

        Returns:
            (n,) NaN during the warm-up or before the first full window, and where `Score` returns NaN.

        Raises:
            FingertipError: if the detector was made for another fingertip.
        """
        score = Score(detector).for_fingertip(self.fingertip)
        probability, counts = np.full(len(self), np.nan), self.counts
        if len(self):
            valid = np.ones(counts.shape, np.bool_) if self.valid is None else self.valid
            touch = Zeroed(self.places * self.sampling.period, counts, np.zeros_like(counts), valid)
            scores = score.push(touch).probability
            probability[len(self) - len(scores) :] = scores
            probability[: self.sampling.warm_up] = np.nan
        return probability


def simulated_recordings(
    plan: PaperPlan, seed: int, change: Callable[[Scene], Scene] = lambda scene: scene
) -> list[LabelledRecording]:
    """Simulate every recording of a plan, each scene altered by `change`."""
    return [
        simulated_recording(change(scene), scene_seed(seed, number), str(number))
        for number, scene in enumerate(plan.scenes(seed))
    ]


def scene_seed(seed: int, number: int) -> int:
    """Return the seed of a scene of a plan."""
    return int(np.random.SeedSequence([seed, number]).generate_state(1)[0])


def simulated_recording(scene: Scene, seed: int, name: str = "") -> LabelledRecording:
    """Simulate one scene; zero, align and label its samples."""
    from connectors.sim.finger import simulate_scene

    touch, motion, truth = simulate_scene(scene, seed)
    zero = Zero()
    zeroed = concat(Zeroed, [zero.push(touch), zero.flush()])
    moves = concat(Episodes, [episode(move, start, 0, scene) for start, move in scene.moves(seed)])
    return LabelledRecording(
        forward_fill(zeroed.counts, zeroed.valid),
        labelled(zeroed, motion).label,
        zeroed.valid,
        _sliding(zeroed, replace(truth, time=touch.time)),  # the clock of the touch may be wrong
        _strokes(moves, truth.time),
        name=name,
        time=zeroed.time,
    )


def load(*datasets: Path) -> list[LabelledRecording]:
    """Read every fingertip of sessions, or of all of datasets, that has samples or labels by hand.

    A label by hand replaces the label by arm speed. A session without samples, as without an arm, is read
    from its touch, with the labels by hand only. Sessions with labels of a dataset in which none has a split
    are assigned in the order given, in datasets in that of their names: seven of ten to train, one to
    validation, two to test.

    Args:
        datasets: Folders of datasets, or of their sessions.

    Raises:
        InputError: if a dataset does not exist, is damaged or has no labelled samples.
    """
    turns, found = cycle(TURNS), list[LabelledRecording]()
    for dataset in datasets:
        recordings = _read(dataset)
        if not any(each.split for each in recordings):
            splits = dict(zip(dict.fromkeys(each.name for each in recordings), turns, strict=False))
            recordings = [replace(each, split=splits[each.name]) for each in recordings]
        found += recordings
    return found


def _read(dataset: Path) -> list[LabelledRecording]:
    make = "make one with `slipflow simulate` or `slipflow run record`"
    if not dataset.is_dir():
        raise InputError(str(dataset), f"there is no such folder; {make}")
    recordings = list[LabelledRecording]()
    for session in map(Session.open, session_folders(dataset)):
        hand = session.hand_labels()
        marked = {span.finger for span in hand.spans}
        if marked:
            marked &= {*session.fingers(Touch)}  # verifies all touch, so only if needed
        for finger in sorted(marked | {*session.fingers(Labelled)}):
            recordings.append(replace(_of_session(session, finger, hand), dataset=str(dataset)))
    if not recordings:
        raise InputError(str(dataset), f"has no labels; {make}, or label by hand with `slipflow show`")
    return recordings


def by_split(recordings: Sequence[LabelledRecording]) -> dict[str, list[LabelledRecording]]:
    """Group recordings by split, in the order of `SPLITS`; omit recordings without a split."""
    return {split: [each for each in recordings if each.split == split] for split in SPLITS}


def common_fingertip(recordings: Iterable[LabelledRecording]) -> Fingertip:
    """Return the fingertip of recordings that are to be used together.

    Raises:
        FingertipError: if cells, rate, unit or a known range differ; it names operators that convert them.
    """
    first, *rest = sorted(recordings, key=lambda each: each.fingertip.range is None)
    for recording in rest:
        own, other = first.fingertip, recording.fingertip
        own.check_fits(owner := f"{recording.name}: a data set with {first.name}", other)
        if (ratio := own.ratio(other)) != 1:
            fix = f"Pool(gain={1 / ratio:.3g}, unit='count') in a flow converts it"
            raise FingertipError(owner, f"the range {own.range}", f"the range {other.range}", fix)
    return first.fingertip


def _of_session(session: Session, finger: int, hand: HandLabels) -> LabelledRecording:
    kind: type[Touch] = Labelled if finger in session.fingers(Labelled) else Touch
    fingertip = session.fingertip(kind)
    if fingertip is None:
        reason = "does not state its fingertip, and its rows share one time, so the rate is unknown"
        raise InputError(session.name, f"{reason}: record or import it again with its layout and rate")
    if kind is Labelled:
        samples: Zeroed = concat(Labelled, list(session.read(Labelled, finger)))
    else:
        zero = Zero()
        samples = concat(Zeroed, [*map(zero.push, session.read(Touch, finger)), zero.flush()])
    label = samples.label if isinstance(samples, Labelled) else np.full(len(samples), UNKNOWN, np.int8)
    episodes = concat(Episodes, list(session.read(Episodes, EVERY)))
    truth = concat(Truth, list(session.read(Truth, finger)))
    return LabelledRecording(
        forward_fill(samples.counts, samples.valid),
        hand.replace(label, samples.time, finger),
        samples.valid,
        _sliding(samples, truth) if len(truth) else None,
        _strokes(episodes, samples.time),
        session.name,
        str(session.about.get("split") or ""),
        str(session.about.get("group") or ""),
        _plan(session),
        fingertip,
        time=samples.time,
    )


def _plan(session: Session) -> str:
    """Return the plan that a simulated session states."""
    sources = session.about.get("sources")
    stated = sources.values() if isinstance(sources, dict) else ()
    plans = [each.get("plan") for each in stated if isinstance(each, dict)]
    return next((each for each in plans if isinstance(each, str)), "")


def _strokes(episodes: Episodes, time: Times) -> Strokes | None:
    """Return the strokes of samples that were taken at `time` (n,) by the clock of the episodes."""
    if not len(episodes):
        return None
    strokes = episodes[np.isin(episodes.motion, [MOTIONS.index(each) for each in _STROKES])]
    speeds = strokes.speed[strokes.motion == MOTIONS.index("translation")]
    oblique = np.append(np.abs(np.sin(2 * strokes.direction)) > _ALONG, False)  # before the first stroke
    return Strokes(
        SURFACES[int(episodes.surface[0])],
        float(speeds[0]) if len(speeds) else None,
        oblique[np.searchsorted(strokes.time, time, "right") - 1],
    )


def labelled(zeroed: Zeroed, motion: Motion, by: Label = PAPER_LABEL) -> Labelled:
    """Run the operators that label samples, as a flow does."""
    align, label = Align(within=20 * ms), by.reset_copy()
    samples = concat(Sample, [align.push(zeroed, motion), align.flush()])
    return concat(Labelled, [label.push(samples), label.flush()])


def _sliding(zeroed: Zeroed, truth: Truth) -> Codes:
    """Return the label of each sample by the true sliding at its time; (n,)."""
    return labelled(zeroed, sliding_motion(truth)).label


def sliding_motion(truth: Truth) -> Motion:
    """Return the true sliding as motion, by which `Align` and `Label` label samples.

    The velocity's first component is the mean sliding speed of the contact over the last 150 ms, the others
    are 0, and the pose is unknown. So stick-slip is one slip, and all evidence for a label lies in the past.
    Between slip and rest the speed is NaN, so that the label is unknown: the mean over 150 ms is at most
    `SLIDING`, but the mean over 250 ms is above a third of it. Late rows are omitted.

    >>> truth = Truth.rows(np.arange(17) * 10 * ms, 0.03, 1.0, 0.0)
    >>> sliding_motion(truth).velocity[[0, 1, 2, 15, 16], 0].round(3)
    array([0.   ,   nan, 0.004, 0.03 , 0.03 ])
    """
    truth = LateRowFilter().filter(truth)
    time = truth.time
    elapsed = np.diff(time, prepend=time[:1])  # (n,) ns
    travel = np.cumsum(np.where(elapsed <= _GAP, truth.sliding * elapsed / 1e9, 0.0))  # (n,) m
    speed, slow = (  # (n,) m/s
        (travel - travel[np.maximum(time.searchsorted(time - span, "right") - 1, 0)]) / (span / 1e9)
        for span in (SLIDING_SPAN, _REST)
    )
    velocity = np.zeros((len(time), 6))
    velocity[:, 0] = np.where((speed <= SLIDING) & (slow > SLIDING / 3), np.nan, speed)
    return Motion(time, time, velocity, np.full_like(velocity, np.nan), finger=truth.finger)
