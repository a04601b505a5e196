"""What a live page is told: frames of the rows that are new, and one of all that is kept for who comes later.

A frame is a JSON object. Times are ms since the start of the run; a fingertip goes by its name, as in events:

- ``now``: the run's clock when the frame was made
- ``touch``: by fingertip, ``t`` (n,) and ``v`` (n, 6), counts, null where a cell did not answer, and whether
  they are ``zeroed``; ``scores``: by fingertip, ``t`` and ``v`` (n,), probability; ``speed``: the same, mm/s
- ``events``: onsets and ends of slips, numbered; ``latency``: ms from an event's time, that of the sample
  that decided, to its arrival here, null in a replay at full speed, where no time passes
- ``slipping``: the fingertips that slip now; ``faults``: by fingertip and barometer, what is wrong
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from connectors.events import faults, finger_name
from connectors.web.series import series, shown
from connectors.web.track import Track
from operators.batch import SLIP, Faults, Motion, Scores, Slips, Touch, Zeroed, ms
from operators.ports import Json, Run

EVENTS: Final = 100  # that are kept
FINGERS: Final = 32  # that are shown; more are left out


@dataclass(frozen=True)
class Rows:
    """Rows of some streams, as views that stay true: they may be written down in a thread."""

    touch: Mapping[int, Touch]  # by finger, as are scores
    scores: Mapping[int, Scores]
    motion: Motion | None

    def document(self, origin: int) -> dict[str, Json]:
        """The part of a frame that tells of them; times are since `origin` (ns)."""
        document: dict[str, Json] = {}
        if self.touch:
            document["touch"] = {
                finger_name(finger): {
                    **series(rows.time, shown(rows), origin),
                    "zeroed": isinstance(rows, Zeroed),
                }
                for finger, rows in self.touch.items()
            }
        if self.scores:
            document["scores"] = {
                finger_name(finger): series(rows.time, shown(rows), origin)
                for finger, rows in self.scores.items()
            }
        if self.motion is not None:
            document["speed"] = series(self.motion.time, shown(self.motion), origin)
        return document


class Frames:
    """Gathers what a run gives, in bounded memory."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._raw: dict[int, Track[Touch]] = {}  # by finger, as are the next two
        self._zeroed: dict[int, Track[Zeroed]] = {}
        self._scores: dict[int, Track[Scores]] = {}
        self._motion = Track(Motion)
        self._slipping: set[str] = set()
        self._faults: dict[str, dict[str, Json]] = {}
        self._events: deque[dict[str, Json]] = deque(maxlen=EVENTS)
        self._numbered = self._told = 0  # events

    def add(self, batch: Touch | Motion | Scores | Slips | Faults) -> None:
        """Take the rows of a batch; a raw touch falls away once its fingertip has given a zeroed one."""
        finger = batch.finger
        if isinstance(batch, Slips):
            self._add_slips(batch)
        elif isinstance(batch, Faults):
            self._add_faults(batch)
        elif isinstance(batch, Motion):
            self._motion.add(batch)
        elif isinstance(batch, Scores):
            if finger in self._scores or len(self._scores) < FINGERS:
                self._scores.setdefault(finger, Track(Scores)).add(batch)
        elif finger not in self._touch() and len(self._touch()) >= FINGERS:
            return
        elif isinstance(batch, Zeroed):
            self._raw.pop(finger, None)
            self._zeroed.setdefault(finger, Track(Zeroed)).add(batch)
        elif finger not in self._zeroed:
            self._raw.setdefault(finger, Track(Touch)).add(batch)

    def next(self) -> dict[str, Json]:
        """The frame of what came since the one before."""
        touch = {finger: track.take() for finger, track in self._touch().items()}
        scores = {finger: track.take() for finger, track in self._scores.items()}
        new = Rows(
            {finger: rows for finger, rows in touch.items() if rows is not None},
            {finger: rows for finger, rows in scores.items() if rows is not None},
            self._motion.take(),
        )
        frame = {**new.document(self._run.start), **self.state()}
        if count := min(self._numbered - self._told, EVENTS):
            frame["events"] = self.events(count)
        self._told = self._numbered
        return frame

    def rows(self) -> Rows:
        """All rows that are kept."""
        touch = {finger: track.rows for finger, track in self._touch().items()}
        return Rows(touch, {finger: track.rows for finger, track in self._scores.items()}, self._motion.rows)

    def state(self) -> dict[str, Json]:
        """The part of a frame that tells of the present."""
        return {
            "now": (self._run.clock.now() - self._run.start) / ms,
            "slipping": [*sorted(self._slipping)],
            "faults": {finger: {**found} for finger, found in self._faults.items() if found},
        }

    def events(self, newest: int = EVENTS) -> list[Json]:
        """The `newest` events, in their order."""
        events: list[Json] = [*self._events]
        return events[-newest:]

    def _touch(self) -> dict[int, Track[Touch] | Track[Zeroed]]:
        return {**self._raw, **self._zeroed}

    def _add_slips(self, batch: Slips) -> None:
        finger = finger_name(batch.finger)
        rows = zip(batch.time.tolist(), batch.state.tolist(), batch.probability.tolist(), strict=True)
        for time, state, probability in rows:
            onset, latency = state == SLIP, self._run.latency(time)
            (self._slipping.add if onset else self._slipping.discard)(finger)
            self._numbered += 1
            self._events.append(
                {
                    "id": self._numbered,
                    "t": (time - self._run.start) / ms,
                    "finger": finger,
                    "onset": onset,
                    "p": round(probability, 3),
                    "latency": None if latency is None else round(latency / ms, 3),
                }
            )

    def _add_faults(self, batch: Faults) -> None:
        finger = finger_name(batch.finger)
        if finger not in self._faults and len(self._faults) >= FINGERS:
            return
        found = self._faults.setdefault(finger, {})
        for _, fault, begins in faults(batch):
            if begins:
                found[str(fault.barometer)] = fault.kind
            elif found.get(str(fault.barometer)) == fault.kind:
                del found[str(fault.barometer)]
