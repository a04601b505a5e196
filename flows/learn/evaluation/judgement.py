"""How good a detector is on some recordings, by sample and by slip event: a row of the chart or a stress."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, Self, TypeAlias

import numpy as np

from connectors.sim.truth import STICK
from flows.learn.evaluation.event_metrics import EventMetrics, Slips, filled
from flows.learn.evaluation.sample_metrics import Confusion
from flows.learn.labelled_recordings import LabelledRecording
from operators import Debounce
from operators.batch import UNKNOWN, Reals

Truth: TypeAlias = Literal["label", "sliding"]  # the arm's speed; what the contact did, sticks filled in
TRUTHS: Final[tuple[Truth, ...]] = ("label", "sliding")


@dataclass(frozen=True, slots=True)
class Judgement:
    """One detector on some recordings, held against one truth.

    A sample without a score is neither right nor wrong; a slip without an onset is missed, whatever the
    reason.
    """

    accuracy: float  # %, of the samples that have a score
    balanced: float  # %, mean of slip and static
    false_alarms_per_min: float  # static minute
    missed: float  # % of slips
    onset_ms: float  # median

    @classmethod
    def of(
        cls,
        recordings: Sequence[LabelledRecording],
        found: Sequence[Reals],
        debounce: Debounce,
        truth: Truth = "label",
    ) -> Self:
        """Judge the probabilities (n,) of each recording: samples at 1/2, slips as debounced."""
        counts = np.zeros((2, 2))
        slips = list[Slips]()
        for recording, probability in zip(recordings, found, strict=True):
            judged = np.isfinite(probability)  # (n,)
            if truth == "sliding":
                slid = Slips.slid(recording)
                assert recording.sliding is not None, "known in simulated recordings"
                assert slid is not None, "the same"
                slip = filled(recording.sliding, STICK)
            else:
                slip, slid = recording.slip, Slips.labelled(recording)
                judged &= recording.label != UNKNOWN
            counts += Confusion.of(probability[judged] >= 1 / 2, slip[judged]).counts
            slips.append(slid)
        right, events = Confusion(counts), EventMetrics.of(found, slips, debounce)
        return cls(
            right.accuracy, right.balanced, events.false_alarms_per_min, events.missed, events.onset_ms
        )
