"""Frames of the live page: rows since the last frame, or all kept rows for a newly connected page.

A frame is a JSON object. Times are ms since the start of the run; fingertips have the names used in events:

- ``now``: time of the run's clock when the frame was made
- ``touch``: by fingertip, ``t`` (n,), ``v`` (n, 6) counts, null for invalid cells, and ``zeroed``
- ``scores``: by fingertip, ``t`` and ``v`` (n,) probability; ``speed``: ``t`` and ``v`` (n,) mm/s
- ``events``: numbered onsets and ends of slip; ``latency``: ms from the deciding sample to its arrival here,
  null in a replay at full speed
- ``slipping``: fingertips that slip now; ``faults``: kind of fault, by fingertip and barometer
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Generic

import numpy as np

from connectors.events import faults, finger_name
from connectors.web.curves import curve_json, event_json, plotted_values
from operators.batch import SLIP, AnyBatch, Faults, Flags, Motion, Scores, Slips, Times, Touch, Zeroed, ms, s
from operators.ports import Json, Run
from operators.tail import Tail

EVENTS_KEPT: Final = 100
FINGERS_MAX: Final = 32  # further fingertips are not shown
KEPT: Final = 30 * s  # ns of each stream
STEP: Final = 5 * ms  # ns; one row is kept per step


class Track(Generic[AnyBatch]):
    """The last 30 s of a stream, reduced to the first row of each 5 ms: at most 6,000 rows.

    Out-of-order rows are dropped.
    """

    def __init__(self, kind: type[AnyBatch]) -> None:
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


@dataclass(frozen=True)
class Rows:
    """Rows of streams, as views that another thread can encode."""

    touch: Mapping[int, Touch]  # by finger
    scores: Mapping[int, Scores]  # by finger
    motion: Motion | None

    def document(self, origin: int) -> dict[str, Json]:
        """Return the curves of a frame, with times since `origin` (ns)."""
        document: dict[str, Json] = {}
        if self.touch:
            document["touch"] = {
                finger_name(finger): {**_curve(rows, origin), "zeroed": isinstance(rows, Zeroed)}
                for finger, rows in self.touch.items()
            }
        if self.scores:
            document["scores"] = {
                finger_name(finger): _curve(rows, origin) for finger, rows in self.scores.items()
            }
        if self.motion is not None:
            document["speed"] = _curve(self.motion, origin)
        return document


class Frames:
    """Collector of the rows and events of a run, with bounded memory."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._raw: dict[int, Track[Touch]] = {}  # by finger, as are the next two
        self._zeroed: dict[int, Track[Zeroed]] = {}
        self._scores: dict[int, Track[Scores]] = {}
        self._motion = Track(Motion)
        self._slipping: set[str] = set()
        self._faults: dict[str, dict[str, Json]] = {}
        self._events: deque[dict[str, Json]] = deque(maxlen=EVENTS_KEPT)
        self._numbered = self._sent = 0  # number of events added and sent

    def add(self, batch: Touch | Motion | Scores | Slips | Faults) -> None:
        """Add a batch; zeroed touch of a fingertip replaces its raw touch."""
        finger = batch.finger
        if isinstance(batch, Slips):
            self._add_slips(batch)
        elif isinstance(batch, Faults):
            self._add_faults(batch)
        elif isinstance(batch, Motion):
            self._motion.add(batch)
        elif isinstance(batch, Scores):
            if finger in self._scores or len(self._scores) < FINGERS_MAX:
                self._scores.setdefault(finger, Track(Scores)).add(batch)
        elif finger not in self._touch() and len(self._touch()) >= FINGERS_MAX:
            return
        elif isinstance(batch, Zeroed):
            self._raw.pop(finger, None)
            self._zeroed.setdefault(finger, Track(Zeroed)).add(batch)
        elif finger not in self._zeroed:
            self._raw.setdefault(finger, Track(Touch)).add(batch)

    def next(self) -> dict[str, Json]:
        """Return the frame of everything added since the last one."""
        touch = {finger: track.take() for finger, track in self._touch().items()}
        scores = {finger: track.take() for finger, track in self._scores.items()}
        new = Rows(
            {finger: rows for finger, rows in touch.items() if rows is not None},
            {finger: rows for finger, rows in scores.items() if rows is not None},
            self._motion.take(),
        )
        frame = {**new.document(self._run.start), **self.state()}
        if count := min(self._numbered - self._sent, EVENTS_KEPT):
            frame["events"] = self.events(count)
        self._sent = self._numbered
        return frame

    def rows(self) -> Rows:
        """Return all kept rows."""
        touch = {finger: track.rows for finger, track in self._touch().items()}
        return Rows(touch, {finger: track.rows for finger, track in self._scores.items()}, self._motion.rows)

    def state(self) -> dict[str, Json]:
        """Return the current time, slipping fingertips and faults."""
        return {
            "now": (self._run.clock.now() - self._run.start) / ms,
            "slipping": [*sorted(self._slipping)],
            "faults": {finger: {**found} for finger, found in self._faults.items() if found},
        }

    def events(self, newest: int = EVENTS_KEPT) -> list[Json]:
        """Return the `newest` events, oldest first."""
        events: list[Json] = [*self._events]
        return events[-newest:]

    def _touch(self) -> dict[int, Track[Touch] | Track[Zeroed]]:
        return {**self._raw, **self._zeroed}

    def _add_slips(self, batch: Slips) -> None:
        finger = finger_name(batch.finger)
        for row in zip(batch.time.tolist(), batch.state.tolist(), batch.probability.tolist(), strict=True):
            time, state, _ = row
            (self._slipping.add if state == SLIP else self._slipping.discard)(finger)
            self._numbered += 1
            latency = self._run.latency(time)
            self._events.append(event_json(self._numbered, finger, row, self._run.start, latency))

    def _add_faults(self, batch: Faults) -> None:
        finger = finger_name(batch.finger)
        if finger not in self._faults and len(self._faults) >= FINGERS_MAX:
            return
        found = self._faults.setdefault(finger, {})
        for _, fault, begins in faults(batch):
            if begins:
                found[str(fault.barometer)] = fault.kind
            elif found.get(str(fault.barometer)) == fault.kind:
                del found[str(fault.barometer)]


def _curve(rows: Touch | Motion | Scores, origin: int) -> dict[str, Json]:
    return curve_json(rows.time, plotted_values(rows), origin)
