"""Frames of the live page: what is new since a browser's last frame.

A frame is a JSON object. Times are ms since the start of the run; fingertips have the names used in events:

- ``now``: time of the run's clock when the frame was made
- ``rows``: by stream and fingertip, ``t`` (n,) and ``v``: (n, cells) counts of ``touch``, null for invalid
  cells; (n,) probability of ``scores``; (n,) TCP speed of ``speed``, mm/s
- ``events``: numbered onsets and ends of slip with their quality; ``latency``: ms from the deciding sample to
  its arrival here, null in a replay
- ``slipping``: fingertips that slip now; ``faults``: kind of fault, by fingertip and barometer
- ``quality``: quality of the newest score and its reason, by fingertip
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Generic, TypeAlias

import numpy as np

from connectors.events import Fault, faults, finger_name, slips
from connectors.web.curves import (
    curve_json,
    event_json,
    faults_json,
    nested,
    plotted_values,
    quality_json,
    stream_name,
)
from operators.batch import AnyBatch, Faults, Flags, Motion, Scores, Slips, Times, Touch, Zeroed, ms, s
from operators.ports import Json, Run
from operators.row_queues import Tail

EVENTS_KEPT: Final = 100
KEPT: Final = 30 * s  # ns of each stream
STEP: Final = 5 * ms  # ns; one row is kept per step

# by stream and fingertip: views that another thread can encode
Rows: TypeAlias = Mapping[tuple[str, str], Touch | Motion | Scores]


@dataclass
class Seen:
    """What a browser has received."""

    rows: dict[tuple[str, str], int] = field(default_factory=dict[tuple[str, str], int])  # counts by stream
    events: int = 0  # number of the newest event


class Track(Generic[AnyBatch]):
    """The last 30 s of a stream, reduced to the first row of each 5 ms: at most 6,000 rows.

    Out-of-order rows are dropped.
    """

    def __init__(self, kind: type[AnyBatch]) -> None:
        self._tail = Tail(kind)
        self._step = int(np.iinfo(np.int64).min)  # index of the newest row's step
        self.count = 0  # rows that were ever kept

    def add(self, batch: AnyBatch) -> None:
        """Append the rows of a batch; all batches must be of one fingertip."""
        kept = batch[self._first_of_steps(batch.time)] if len(batch) > 1 else batch
        if not len(kept):
            return
        newest: int = kept.time.item(-1)
        if newest // STEP <= self._step:
            return
        self._step = newest // STEP
        self._tail.append(kept)
        self._tail.drop(int(np.searchsorted(self._tail.time, newest - KEPT)))
        self.count += len(kept)

    def since(self, count: int) -> AnyBatch:
        """Return the kept rows but the first `count` ever, as views that remain unchanged."""
        return self._tail.rows[max(0, len(self._tail) - (self.count - count)) :]

    def _first_of_steps(self, time: Times) -> Flags:
        """Mark the rows (n,) that are the first of their step and not out of order."""
        steps: Times = time // STEP
        before: Times = np.maximum.accumulate(np.append(np.int64(self._step), steps[:-1]))
        return steps > before


class Frames:
    """Collector of the rows and events of a run, with bounded memory.

    Args:
        run: Run.
        zeroed: Ignore touch that is not zeroed.
    """

    def __init__(self, run: Run, *, zeroed: bool) -> None:
        self._run, self._zeroed = run, zeroed
        self._tracks: dict[tuple[str, str], Track[Any]] = {}  # by stream and fingertip
        self._scores: dict[str, float] = {}  # newest probability by fingertip
        self._slipping: set[str] = set()
        self._faults: dict[str, set[Fault]] = {}  # active, by fingertip
        self._events: deque[dict[str, Json]] = deque(maxlen=EVENTS_KEPT)
        self._numbered = 0  # number of the newest event

    def add(self, batch: Touch | Motion | Scores | Slips | Faults) -> None:
        """Add a batch."""
        finger = finger_name(batch.finger)
        if isinstance(batch, Slips):
            self._add_slips(batch, finger)
        elif isinstance(batch, Faults):
            active = self._faults.setdefault(finger, set())
            for _, fault, begins in faults(batch):
                (active.add if begins else active.discard)(fault)
        elif not isinstance(batch, Touch) or isinstance(batch, Zeroed) or not self._zeroed:
            self._add_rows(batch, finger)

    def since(self, seen: Seen) -> tuple[Rows, dict[str, Json]]:
        """Return what is new for a browser: rows, and all else as JSON; note that it has received them."""
        rows = {key: track.since(seen.rows.get(key, 0)) for key, track in self._tracks.items()}
        events: list[Json] = [*self._events]
        newest = max(0, len(events) - (self._numbered - seen.events))
        seen.rows = {key: track.count for key, track in self._tracks.items()}
        seen.events = self._numbered
        return {key: each for key, each in rows.items() if len(each)}, {
            "now": (self._run.clock.now() - self._run.start) / ms,
            "events": events[newest:],
            "slipping": [*sorted(self._slipping)],
            "faults": faults_json(self._faults),
            "quality": {
                finger: quality_json(probability, self._faults.get(finger, ()))
                for finger, probability in self._scores.items()
            },
        }

    def _add_rows(self, batch: Touch | Motion | Scores, finger: str) -> None:
        key = stream_name(batch), finger
        if key not in self._tracks:
            kind = next(each for each in (Touch, Scores, Motion) if isinstance(batch, each))
            self._tracks[key] = Track[Any](kind)  # drops further columns
        if isinstance(batch, Scores) and len(batch):
            self._scores[finger] = batch.probability.item(-1)
        self._tracks[key].add(batch)

    def _add_slips(self, batch: Slips, finger: str) -> None:
        for slip in slips(batch):
            (self._slipping.add if slip.onset else self._slipping.discard)(finger)
            self._numbered += 1
            latency = self._run.latency(slip.time)
            active = self._faults.get(finger, ())
            self._events.append(
                event_json(self._numbered, finger, slip, self._run.start, latency=latency, faults=active)
            )


def rows_json(rows: Rows, origin: int) -> dict[str, Json]:
    """Return rows as JSON, with times since `origin` (ns)."""
    return nested({key: curve_json(each.time, plotted_values(each), origin) for key, each in rows.items()})
