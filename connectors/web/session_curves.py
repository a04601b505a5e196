"""Curves, labels and events of a recorded session, kept in memory for its page."""

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import replace
from operator import itemgetter
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from connectors.events import Fault, Slip, faults, finger_name, slips
from connectors.sim.simulated_rig import true_slips
from connectors.web.curves import (
    GAP,
    curve_json,
    event_json,
    faults_json,
    nested,
    page_fingertip,
    plotted_values,
    quality_json,
    stream_name,
    thin_curve,
)
from operators import Debounce
from operators.batch import (
    SLIP,
    STATIC,
    Codes,
    Faults,
    Flags,
    Labelled,
    Motion,
    Scores,
    Slips,
    Times,
    Truth,
    Zeroed,
    concat,
    ms,
    s,
)
from operators.errors import InputError
from operators.ports import Json, Run, Sink

VALID_FOR: Final = 1 * s  # ns, maximum age of a row in `values_at`
ROWS_MAX: Final = 20_000_000  # of all streams together, about 1 GB
EVENTS_MAX: Final = 20_000
Values: TypeAlias = NDArray[np.float32 | np.float64]  # (n, ...) of a curve
_Key: TypeAlias = tuple[str, str]  # stream and fingertip
_Event: TypeAlias = tuple[str, Slip]  # with its fingertip


class SessionCurves(Sink[Zeroed | Motion | Scores | Slips | Faults | Truth]):
    """Sink that keeps the curves, events and labels of a replay in memory.

    Labelled touch and truth become the bands ``arm`` and ``truth``; touch without labels becomes curves.

    Args:
        rule: Rule of `detected`; the page marks its threshold.
        about: Text for the page.

    Attributes:
        curves: Times and values of each stream (touch, scores, speed) and fingertip, once closed.
        scores: Scores of each fingertip, once closed.
        bands: Runs of equal labels, as [begin, end, code] with times in ms since the start, once closed.
    """

    def __init__(self, *, rule: Debounce | None = None, about: str = "") -> None:
        self.rule, self.about = rule or Debounce(), about
        self.start = self.end = 0  # ns, start of the run and newest row
        self._arriving: dict[_Key, list[tuple[Times, Values]]] = {}  # joined in `close`
        self.curves: dict[_Key, tuple[Times, Values]] = {}
        self._scored: dict[str, list[Scores]] = {}  # batches by fingertip
        self.scores: dict[str, Scores] = {}
        self._truth: dict[str, list[Truth]] = {}
        self.bands: dict[_Key, list[Json]] = {}
        self._faults: dict[str, list[tuple[int, frozenset[Fault]]]] = {}  # time (ns) and active ones
        self._events: list[_Event] = []
        self._rows = 0

    @property
    def destination(self) -> str:
        """Constant name of the memory of this process."""
        return "memory"

    async def open(self, run: Run) -> None:
        """Set the session and the start of `run`."""
        self._session, self.start = run.session, run.start
        self._fingertip = page_fingertip(run, self.destination)

    def take(self, batch: Zeroed | Motion | Scores | Slips | Faults | Truth) -> bool:
        """Keep the rows of a batch.

        Raises:
            InputError: if the session has too many rows or events.
        """
        finger = finger_name(batch.finger)
        if isinstance(batch, Slips):
            self._events.extend((finger, slip) for slip in slips(batch))
        elif isinstance(batch, Faults):
            known = self._faults.setdefault(finger, [])
            for time, fault, begins in faults(batch):
                active = known[-1][1] if known else frozenset[Fault]()
                known.append((time, active | {fault} if begins else active - {fault}))
        elif isinstance(batch, Scores):
            self._scored.setdefault(finger, []).append(batch)
        elif isinstance(batch, Truth):
            self._truth.setdefault(finger, []).append(batch)
        elif isinstance(batch, Labelled):
            self._arriving.setdefault(("arm", finger), []).append(
                (batch.time, batch.label.astype(np.float32))
            )
        else:
            values = plotted_values(batch).astype(np.float32)
            self._arriving.setdefault((stream_name(batch), finger), []).append((batch.time, values))
        self._rows += len(batch)
        self.end = max(self.end, int(batch.time.max(initial=self.start)))
        if self._rows > ROWS_MAX or len(self._events) > EVENTS_MAX:
            most = f"{ROWS_MAX:,} rows and {EVENTS_MAX:,} events"
            raise InputError(self._session, f"is too long for a page, which shows at most {most}")
        return True

    async def close(self) -> None:
        """Join the batches; out-of-order rows are dropped."""
        for key, parts in self._arriving.items():
            time = np.concatenate([each for each, _ in parts])  # (n,) ns
            values = np.concatenate([each for _, each in parts])  # (n, ...)
            kept = _in_order(time)
            if key[0] == "arm":
                self.bands[key] = self._runs(time[kept], values[kept].astype(np.int8))
            else:
                self.curves[key] = time[kept], values[kept]
        for finger, batches in self._scored.items():
            joined = concat(Scores, batches)
            self.scores[finger] = scores = joined[_in_order(joined.time)]
            self.curves["scores", finger] = scores.time, scores.probability
        for finger, truths in self._truth.items():
            truth = concat(Truth, truths)
            truth = truth[_in_order(truth.time)]
            code = np.full(len(truth), STATIC, np.int8)
            for onset, end in true_slips(truth):
                code[(truth.time >= onset) & (truth.time <= end)] = SLIP
            self.bands["truth", finger] = self._runs(truth.time, code)
        self._arriving.clear()
        self._scored.clear()
        self._truth.clear()

    def contents(self) -> dict[str, Json]:
        """Return the first document of the page; times are in ms since `start`."""
        return {
            "session": self._session,
            "fingertip": self._fingertip,
            "about": self.about,
            "start": self.start / ms,
            "length": (self.end - self.start) / ms,
            "threshold": self.rule.threshold,
            "scored": bool(self.scores),
            "events": self._events_json(self._events),
            "bands": nested(self.bands),
        }

    def detected(self, threshold: float) -> list[Json]:
        """Return the events that the debounce finds in the scores at another threshold.

        Raises:
            ParameterError: if the threshold is not above 0 and at most 1.
            InputError: if there are too many events.
        """
        rule, events = replace(self.rule, threshold=threshold), list[_Event]()
        for finger, scores in self.scores.items():
            events.extend((finger, slip) for slip in slips(rule.reset_copy().push(scores)))
        if len(events) > EVENTS_MAX:
            raise InputError(self._session, f"has more than {EVENTS_MAX:,} events at this threshold")
        return self._events_json(events)

    def window(self, begin: float, end: float, columns: int) -> dict[str, Json]:
        """Return the curves from `begin` to `end` (ms since `start`) by stream and fingertip.

        Curves are reduced to the minimum and maximum of each of `columns` pixel columns.
        """
        first, last = (self.start + round(each * ms) for each in (begin, end))

        def cut(time: Times, values: Values) -> dict[str, Json]:
            rows = slice(*np.searchsorted(time, [first, last + 1]))
            return curve_json(*thin_curve(time[rows], values[rows], first, last, columns), self.start)

        return self._cut(cut)

    def values_at(self, instant: float) -> dict[str, Json]:
        """Return the newest row of each stream, faults and quality at an instant (ms since `start`).

        Rows that are older than 1 s are left out.
        """
        at = self.start + round(instant * ms)

        def row(time: Times) -> slice:
            first, end = np.searchsorted(time, [at - VALID_FOR, at + 1])
            return slice(max(first, end - 1), end)

        def newest(time: Times, values: Values) -> dict[str, Json]:
            return curve_json(time[row(time)], values[row(time)], self.start)

        scores = {finger: each[row(each.time)] for finger, each in self.scores.items()}
        return {
            "rows": self._cut(newest),
            "faults": faults_json({finger: self._faults_at(finger, at) for finger in self._faults}),
            "quality": {
                finger: quality_json(each.probability.item(), self._faults_at(finger, at))
                for finger, each in scores.items()
                if len(each)
            },
        }

    def _faults_at(self, finger: str, time: int) -> frozenset[Fault]:
        known = self._faults.get(finger, [])
        row = bisect_right(known, time, key=itemgetter(0))
        return known[row - 1][1] if row else frozenset()

    def _cut(self, cut: Callable[[Times, Values], dict[str, Json]]) -> dict[str, Json]:
        """Return all curves, each cut by `cut`."""
        return nested({key: cut(*curve) for key, curve in self.curves.items()})

    def _events_json(self, events: list[_Event]) -> list[Json]:
        """Return events in order of time; fingertips are written one after the other."""
        ordered = sorted(events, key=lambda event: event[1].time)
        return [
            event_json(number, finger, slip, self.start, faults=self._faults_at(finger, slip.time))
            for number, (finger, slip) in enumerate(ordered, 1)
        ]

    def _runs(self, time: Times, code: Codes) -> list[Json]:
        """Return the runs of equal codes of rows in order of time; a pause of more than 250 ms ends a run."""
        pauses = np.append(np.diff(time) > GAP, np.True_)
        last = np.flatnonzero(np.append(np.diff(code) != 0, np.True_) | pauses)[: len(time)]
        first = np.append(0, last + 1)[: len(last)]
        ends = time[np.where(pauses[last], last, np.minimum(last + 1, len(time) - 1))]
        begin, end = (((each - self.start) / ms).round(3).tolist() for each in (time[first], ends))
        return [list(run) for run in zip(begin, end, code[first].tolist(), strict=True)]


def _in_order(time: Times) -> Flags:
    """Return which rows are later than all before them."""
    before = np.maximum.accumulate(time)[:-1]  # (n - 1,)
    return np.concatenate(([True], time[1:] > before))[: len(time)]
