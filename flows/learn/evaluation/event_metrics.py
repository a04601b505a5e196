"""What users of slip events feel: false alarms, missed slips, and how late onsets come."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from connectors.sim.truth import STICK
from flows.learn.evaluation.sample_metrics import percent
from flows.learn.labelled_recordings import WARM_UP, LabelledRecording
from flows.learn.onsets import match_onsets, runs
from operators import Debounce, ms, s
from operators.batch import SLIP, STATIC, Flags, Reals, Scores, Times

PERIOD: Final = 10 * ms  # ns from one sample to the next
PAUSE: Final = 100 * ms  # ns; a label that goes back to static for less goes on
BRIEF: Final = 50 * ms  # ns; labels are no surer than that (paper, Fig. 6)


@dataclass(frozen=True, slots=True)
class Slips:
    """The slips that onsets in a recording are held against; ns from its first sample.

    A slip that pauses for less than `PAUSE` goes on: nobody wants two events of it. One that is shorter than
    `BRIEF`, or that began before anything is judged, need not be found; an onset there is not false either.
    Nor is one where nobody knows whether it slips.
    """

    found: tuple[tuple[int, int], ...]  # start and end of each slip that is to be found
    excused: tuple[tuple[int, int], ...]  # start and end of each other stretch in which onsets are not false
    static: int  # ns that are judged and are none of these

    @classmethod
    def labelled(cls, recording: LabelledRecording) -> Self:
        """By the arm's speed, as the paper has it."""
        return cls.of(recording.slip, PAUSE, (recording.label != SLIP) & (recording.label != STATIC))

    @classmethod
    def slid(cls, recording: LabelledRecording) -> Self | None:
        """By what the contact did, where that is known; a stick of less than `STICK` is a part of a slip."""
        return None if recording.sliding is None else cls.of(recording.sliding, STICK)

    @classmethod
    def of(cls, slip: Flags, pause: int, unknown: Flags | None = None) -> Self:
        """From the samples (n,) that are slip; those that are `unknown` (n,) are neither slip nor static.

        >>> slip = np.arange(300) // 50 == 3
        >>> Slips.of(slip, PAUSE).found == ((1500 * ms, 1990 * ms),)
        True
        """
        starts, ends = bridged(slip, pause)
        found = (ends - starts >= BRIEF // PERIOD - 1) & (starts >= WARM_UP)  # (k,)
        if unknown is None:
            unknown = np.zeros(len(slip), np.bool_)
        excused = [*_stretches(starts[~found], ends[~found]), *_stretches(*bridged(unknown, 0))]
        static = int((~filled(slip, pause) & ~unknown)[WARM_UP:].sum()) * PERIOD
        return cls(_stretches(starts[found], ends[found]), tuple(sorted(excused)), static)


def bridged(flags: Flags, pause: int) -> tuple[Times, Times]:
    """First and last sample of each run of True, runs closer than `pause` ns joined; (k,) and (k,)."""
    starts, ends = runs(flags).T
    if not len(starts):
        return starts, ends
    apart = (starts[1:] - ends[:-1]) * PERIOD >= max(pause, 1)
    return starts[np.append(True, apart)], ends[np.append(apart, True)] - 1


def filled(flags: Flags, pause: int) -> Flags:
    """The same with the pauses filled; (n,)."""
    steps = np.zeros(len(flags) + 1, np.int8)
    starts, ends = bridged(flags, pause)
    steps[starts], steps[ends + 1] = 1, -1
    joined: Flags = np.cumsum(steps)[:-1] > 0
    return joined


def _stretches(starts: Times, ends: Times) -> tuple[tuple[int, int], ...]:
    return tuple(zip((starts * PERIOD).tolist(), (ends * PERIOD).tolist(), strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class EventMetrics:
    """The onsets of some recordings, held against their slips.

    An onset from 50 ms before a slip to 150 ms after it is an answer. A slip needs an onset of its own: one
    that begins while the slip before it is still reported is missed.
    """

    delays: Reals  # (caught,) ms from the start of each slip that was found to its first onset
    missed_slips: int
    false_alarms: int
    repeats: int  # onsets of a slip after its first
    minutes: float  # of static

    @classmethod
    def of(cls, probabilities: Sequence[Reals], slips: Sequence[Slips], debounce: Debounce) -> Self:
        """Debounce the probabilities (n,) of each recording, and match the onsets with its slips."""
        delays, missed, false, repeats = list[Times](), 0, 0, 0
        for probability, true in zip(probabilities, slips, strict=True):
            raised = onsets(probability, debounce)
            answered = match_onsets(raised, true.found)
            delays.append(answered.delays)
            missed += answered.missed
            false += match_onsets(raised, (*true.found, *true.excused)).false
            repeats += len(raised) - answered.false - len(answered.delays)
        minutes = sum(true.static for true in slips) / (60 * s)
        return cls(np.concatenate([np.empty(0), *delays]) / ms, missed, false, repeats, minutes)

    @property
    def slips(self) -> int:
        """Slips that were to be found."""
        return len(self.delays) + self.missed_slips

    @property
    def false_alarms_per_min(self) -> float:
        """Onsets without a slip, per static minute."""
        return self.false_alarms / self.minutes if self.minutes else float("nan")

    @property
    def missed(self) -> float:
        """Slips without an onset, %."""
        return percent(self.missed_slips, self.slips)

    @property
    def repeated(self) -> float:
        """Onsets of a slip after its first, % of the slips."""
        return percent(self.repeats, self.slips)

    @property
    def onset_ms(self) -> float:
        """Median delay of the onsets, ms."""
        return self.quantile(0.5)

    @property
    def late_ms(self) -> float:
        """Delay that one onset in ten exceeds, ms."""
        return self.quantile(0.9)

    def quantile(self, share: float) -> float:
        """Delay that this share of the onsets does not exceed, ms."""
        return float(np.quantile(self.delays, share)) if len(self.delays) else float("nan")


def onsets(probability: Reals, debounce: Debounce) -> Times:
    """When the operator says that a slip begins; (k,) ns from the first of the probabilities (n,)."""
    scores = Scores(np.arange(len(probability)) * PERIOD, probability)
    slips = debounce.reset_copy().push(scores[WARM_UP:])
    raised: Times = slips.time[slips.state == SLIP]
    return raised
