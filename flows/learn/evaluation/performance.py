"""Performance of a detector on some recordings, by sample and by slip event."""

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

Reference: TypeAlias = Literal["label", "sliding"]  # arm speed; true sliding of the contact, sticks filled
REFERENCES: Final[tuple[Reference, ...]] = ("label", "sliding")
DECISION: Final = 0.5  # probability from which on a sample counts as slip


@dataclass(frozen=True, slots=True)
class Performance:
    """Performance of one detector against one reference.

    Samples without a score do not count. Every slip without an onset is missed.
    """

    accuracy: float  # %, of the samples that have a score
    balanced: float  # balanced accuracy, %
    false_alarms_per_min: float  # per static minute
    missed: float  # % of slips
    onset_ms: float  # median delay

    @classmethod
    def of(
        cls,
        recordings: Sequence[LabelledRecording],
        probabilities: Sequence[Reals],
        debounce: Debounce,
        reference: Reference = "label",
    ) -> Self:
        """Compare the probabilities (n,) of each recording with a reference.

        Args:
            recordings: recordings; the reference "sliding" needs simulated ones.
            probabilities: probability of slip, (n,) for each recording.
            debounce: debounce of the slip events.
            reference: reference for true slip.
        """
        counts = np.zeros((2, 2))
        slips = list[Slips]()
        for recording, probability in zip(recordings, probabilities, strict=True):
            known = np.isfinite(probability)  # (n,)
            if reference == "sliding":
                slid = Slips.slid(recording)
                assert recording.sliding is not None, "simulated recordings have it"
                assert slid is not None, "simulated recordings have it"
                slip = filled(recording.sliding, STICK)
            else:
                slip, slid = recording.slip, Slips.labelled(recording)
                known &= recording.label != UNKNOWN
            counts += Confusion.of(probability[known] >= DECISION, slip[known]).counts
            slips.append(slid)
        samples, events = Confusion(counts), EventMetrics.of(probabilities, slips, debounce)
        return cls(
            samples.accuracy,
            samples.balanced,
            events.false_alarms_per_min,
            events.missed,
            events.onset_ms,
        )
