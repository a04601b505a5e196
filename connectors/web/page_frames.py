"""Frames of the live page: rows since the last frame, or all kept rows for a newly connected page.

A frame is a JSON object. Times are ms since the start of the run; fingertips have the names used in events:

- ``now``: time of the run's clock when the frame was made
- ``touch``: by fingertip, ``t`` (n,), ``v`` (n, cells) counts, null for invalid cells, and ``zeroed``
- ``scores``: by fingertip, ``t`` and ``v`` (n,) probability; ``speed``: ``t`` and ``v`` (n,) mm/s
- ``truth``: by fingertip, ``t`` and ``v`` (n,), 1 while the simulated contact slides, else 0
- ``events``: numbered onsets and ends of slip with their quality; ``latency``: ms from the deciding sample to
  its arrival here, null in a replay at full speed; ``verdict`` on it: word and level
- ``slipping``: fingertips that slip now; ``faults``: kind of fault, by fingertip and barometer
- ``quality``: quality of the newest score and its reason, by fingertip
"""

from collections import deque
from collections.abc import Mapping
from typing import Any, Final, Generic, TypeAlias

import numpy as np

from connectors.events import finger_name, slips
from connectors.web.cell_faults import NO_FAULTS, CellFaults, changes, fault_list
from connectors.web.curves import (
    curve_json,
    event_json,
    plotted_values,
    score_quality,
    stream_name,
    streams_json,
)
from operators.batch import (
    AnyBatch,
    Faults,
    Flags,
    Motion,
    Scores,
    Slips,
    Times,
    Touch,
    Truth,
    Zeroed,
    ms,
    s,
)
from operators.ports import Json, Run
from operators.tail import Tail

EVENTS_KEPT: Final = 100
FINGERS_MAX: Final = 32  # further fingertips are not shown
KEPT: Final = 30 * s  # ns of each stream
STEP: Final = 5 * ms  # ns; one row is kept per step

# by stream and fingertip: views that another thread can encode
Rows: TypeAlias = Mapping[tuple[str, str], Touch | Motion | Scores | Truth]


class Track(Generic[AnyBatch]):
    """The last 30 s of a stream, reduced to the first row of each 5 ms: at most 6,000 rows.

    Out-of-order rows are dropped.
    """

    def __init__(self, kind: type[AnyBatch]) -> None:
        self.kind = kind
        self._tail = Tail(kind)
        self._step = int(np.iinfo(np.int64).min)  # index of the newest row's step
        self._new = 0  # rows not yet returned by `take`

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
        self._new = min(self._new + len(kept), len(self._tail))

    @property
    def rows(self) -> AnyBatch:
        """All kept rows, as views that remain unchanged."""
        return self._tail.rows

    def take(self) -> AnyBatch | None:
        """Return the rows added since the last call, as views; None if there are none."""
        if not self._new:
            return None
        count, self._new = self._new, 0
        return self._tail.rows[-count:]

    def _first_of_steps(self, time: Times) -> Flags:
        """Mark the rows (n,) that are the first of their step and not out of order."""
        steps: Times = time // STEP
        before: Times = np.maximum.accumulate(np.append(np.int64(self._step), steps[:-1]))
        return steps > before


class Frames:
    """Collector of the rows and events of a run, with bounded memory."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._tracks: dict[tuple[str, str], Track[Any]] = {}  # by stream and fingertip
        self._scores: dict[str, Scores] = {}  # newest batch by fingertip
        self._slipping: set[str] = set()
        self._faults: dict[str, CellFaults] = {}
        self._events: deque[dict[str, Json]] = deque(maxlen=EVENTS_KEPT)
        self._numbered = self._sent = 0  # number of events added and sent

    def add(self, batch: Touch | Motion | Scores | Slips | Faults | Truth) -> None:
        """Add a batch; zeroed touch of a fingertip replaces its raw touch."""
        if isinstance(batch, Slips):
            self._add_slips(batch)
        elif isinstance(batch, Faults):
            self._add_faults(batch)
        else:
            key = stream_name(batch), finger_name(batch.finger)
            track, zeroed = self._tracks.get(key), isinstance(batch, Zeroed)
            if track is None and sum(each[0] == key[0] for each in self._tracks) >= FINGERS_MAX:
                return
            if track is None or (zeroed and track.kind is Touch):
                base = next((each for each in (Touch, Scores, Truth) if isinstance(batch, each)), Motion)
                kind = Zeroed if zeroed else base  # drops further columns
                track = self._tracks[key] = Track(kind)
            if isinstance(batch, Scores) and len(batch):
                self._scores[key[1]] = batch
            if zeroed or track.kind is not Zeroed:
                track.add(batch)

    def next(self) -> dict[str, Json]:
        """Return the frame of everything added since the last one."""
        new = {key: rows for key, track in self._tracks.items() if (rows := track.take()) is not None}
        frame = {**rows_json(new, self._run.start), **self.state()}
        if count := min(self._numbered - self._sent, EVENTS_KEPT):
            frame["events"] = self.events(count)
        self._sent = self._numbered
        return frame

    def rows(self) -> Rows:
        """Return all kept rows."""
        return {key: track.rows for key, track in self._tracks.items()}

    def state(self) -> dict[str, Json]:
        """Return the current time, slipping fingertips, faults and quality."""
        newest = {finger: batch[-1:] for finger, batch in self._scores.items()}
        return {
            "now": (self._run.clock.now() - self._run.start) / ms,
            "slipping": [*sorted(self._slipping)],
            "faults": {finger: {**found} for finger, found in self._faults.items() if found},
            "quality": {
                finger: score_quality(row, fault_list(self._faults.get(finger, NO_FAULTS)))
                for finger, row in newest.items()
            },
        }

    def events(self, newest: int = EVENTS_KEPT) -> list[Json]:
        """Return the `newest` events, oldest first."""
        events: list[Json] = [*self._events]
        return events[-newest:]

    def _add_slips(self, batch: Slips) -> None:
        finger = finger_name(batch.finger)
        for slip in slips(batch):
            (self._slipping.add if slip.onset else self._slipping.discard)(finger)
            self._numbered += 1
            latency = self._run.latency(slip.time)
            found = fault_list(self._faults.get(finger, NO_FAULTS))
            self._events.append(
                event_json(self._numbered, finger, slip, self._run.start, latency=latency, faults=found)
            )

    def _add_faults(self, batch: Faults) -> None:
        finger = finger_name(batch.finger)
        if finger not in self._faults and len(self._faults) >= FINGERS_MAX:
            return
        for _, found in changes(batch, self._faults.get(finger, NO_FAULTS)):
            self._faults[finger] = found


def rows_json(rows: Rows, origin: int) -> dict[str, Json]:
    """Return rows as the curves of a frame, with times since `origin` (ns)."""
    return streams_json(
        {key: curve_json(each.time, plotted_values(each), origin) for key, each in rows.items()},
        {key for key, each in rows.items() if isinstance(each, Zeroed)},
    )
