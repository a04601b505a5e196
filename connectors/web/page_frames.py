"""Frames of the live page: what is new since a browser's last frame.

A frame is a JSON object. Times are ms since the start of the run; fingertips have the names used in events:

- ``now``: time of the run's clock when the frame was made
- ``rows``: by stream and fingertip, such as ``touch 0``, ``t`` (n,) and ``v``: (n, cells) counts of
  ``touch``, null for invalid cells; (n,) probability of ``scores``; (n,) TCP speed of ``speed``, mm/s
- ``events``: numbered onsets and ends of slip with their quality; ``latency``: ms from the deciding sample to
  its arrival here, null in a replay
- ``slipping``: fingertips that slip now; ``faults``: kind of fault, by fingertip and barometer
- ``quality``: quality of the newest score and its reason, by fingertip
"""

from collections import defaultdict, deque
from collections.abc import Iterable
from itertools import takewhile
from typing import Final, NamedTuple

import numpy as np

from connectors.events import Fault, faults, finger_name, quality, slips
from connectors.web.curves import curve_json, event_json, faults_json, plotted, thin_curve
from operators.batch import Faults, Motion, Reals, Scores, Slips, Times, Touch, Zeroed, ms, s
from operators.ports import Json, Run

EVENTS_KEPT: Final = 100
KEPT: Final = 30 * s  # ns of each stream
STEP: Final = 5 * ms  # ns; more than two rows per step are reduced to their extremes


class Rows(NamedTuple):
    """Rows of a batch, which do not change."""

    number: int  # of the batch
    curve: str
    time: Times
    values: Reals


class Frames:
    """Collector of the rows and events of a run, with bounded memory.

    Args:
        run: Run.
        zeroed: Ignore touch that is not zeroed.

    Attributes:
        count: Number of batches so far.
    """

    def __init__(self, run: Run, *, zeroed: bool) -> None:
        self._run, self._zeroed, self.count = run, zeroed, 0
        self._rows = deque[Rows]()
        self._scores: dict[str, float] = {}  # newest probability by fingertip
        self._slipping: set[str] = set()
        self._faults: dict[str, set[Fault]] = {}  # active, by fingertip
        self._events: deque[tuple[int, dict[str, Json]]] = deque(maxlen=EVENTS_KEPT)  # number of the batch
        self._numbered = 0  # number of the newest event

    def add(self, batch: Touch | Motion | Scores | Slips | Faults) -> None:
        """Add a batch."""
        self.count += 1
        finger = finger_name(batch.finger)
        active = self._faults.setdefault(finger, set())
        if isinstance(batch, Slips):
            for slip in slips(batch):
                (self._slipping.add if slip.onset else self._slipping.discard)(finger)
                self._numbered += 1
                latency = self._run.latency(slip.time)
                event = event_json(
                    self._numbered, finger, slip, self._run.start, latency=latency, faults=active
                )
                self._events.append((self.count, event))
        elif isinstance(batch, Faults):
            for _, fault, begins in faults(batch):
                (active.add if begins else active.discard)(fault)
        elif len(batch) and (not isinstance(batch, Touch) or isinstance(batch, Zeroed) or not self._zeroed):
            oldest = batch.time.item(-1) - KEPT
            kept = batch[int(batch.time.searchsorted(oldest)) :]
            curve, values = plotted(kept)
            self._rows.append(Rows(self.count, curve, kept.time, values))
            while self._rows[0].time[-1] < oldest:
                self._rows.popleft()
            if isinstance(batch, Scores):
                self._scores[finger] = batch.probability.item(-1)

    def since(self, seen: int) -> tuple[list[Rows], dict[str, Json]]:
        """Return what came after the first `seen` batches: rows, and all else as JSON."""
        rows = [*takewhile(lambda each: each.number > seen, reversed(self._rows))]
        return rows[::-1], {
            "now": (self._run.clock.now() - self._run.start) / ms,
            "events": [event for number, event in self._events if number > seen],
            "slipping": sorted(self._slipping),
            "faults": faults_json(self._faults),
            "quality": {
                finger: quality(probability, self._faults[finger])
                for finger, probability in self._scores.items()
            },
        }


def rows_json(rows: Iterable[Rows], origin: int) -> dict[str, Json]:
    """Return rows by curve as JSON, with times since `origin` (ns)."""
    curves = defaultdict[str, list[Rows]](list)
    for each in rows:
        curves[each.curve].append(each)
    found: dict[str, Json] = {}
    for name, parts in curves.items():
        time = np.concatenate([each.time for each in parts])
        values = np.concatenate([each.values for each in parts])
        begin, end = time.item(0), time.item(-1)
        thin = thin_curve(time, values, begin, end, 1 + (end - begin) // STEP)
        found[name] = curve_json(*thin, origin)
    return found
