"""Curves, labels and events of a recorded session, kept in memory for its page."""

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from operator import itemgetter
from typing import Any, Final, TypeAlias

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
from operators.operator import LateRowFilter
from operators.ports import Json, Run, Sink

VALID_FOR: Final = 1 * s  # ns, maximum age of a row in `values_at`
ROWS_MAX: Final = 20_000_000  # of all streams together, about 1 GB
EVENTS_MAX: Final = 20_000
Values: TypeAlias = NDArray[Any]  # (n, ...) of a curve
_Key: TypeAlias = tuple[str, str]  # stream and fingertip
_Event: TypeAlias = tuple[str, Slip]  # with its fingertip


class SessionCurves(Sink[Zeroed | Motion | Scores | Slips | Faults | Truth]):
    """Sink that keeps the curves, events and labels of a replay in memory, without late rows.

    Labelled touch and truth become the bands ``label`` and ``truth``; touch without labels becomes curves.

    Args:
        rule: Rule of `detected`; the page marks its threshold.
        about: Text for the page.

    Attributes:
        curves: Times and values of each stream (touch, scores, speed) and fingertip, once closed.
        bands: Runs of equal labels, as [begin, end, code] with times in ms since the start, once closed.
    """

    def __init__(self, rule: Debounce, about: str) -> None:
        self.rule, self.about = rule, about
        self.start = self.end = 0  # ns, start of the run and newest row
        self._late = defaultdict[tuple[type, str], LateRowFilter](LateRowFilter)  # by type and fingertip
        self._arriving = defaultdict[_Key, list[tuple[Times, Values]]](list)  # joined in `close`
        self.curves: dict[_Key, tuple[Times, Values]] = {}
        self._truth = defaultdict[str, list[Truth]](list)  # by fingertip
        self.bands: dict[_Key, list[Json]] = {}
        self._faults = defaultdict[str, list[tuple[int, frozenset[Fault]]]](list)  # time (ns), active ones
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
        if len(batch):
            batch = self._late[type(batch), finger].filter(batch)
        if isinstance(batch, Slips):
            self._events.extend((finger, slip) for slip in slips(batch))
        elif isinstance(batch, Faults):
            known = self._faults[finger]
            for time, fault, begins in faults(batch):
                active = known[-1][1] if known else frozenset[Fault]()
                known.append((time, active | {fault} if begins else active - {fault}))
        elif isinstance(batch, Truth):
            self._truth[finger].append(batch)
        elif isinstance(batch, Labelled):
            self._arriving["label", finger].append((batch.time, batch.label))
        else:
            kind = np.float64 if isinstance(batch, Scores) else np.float32  # scores are detected again
            values = plotted_values(batch).astype(kind)
            self._arriving[stream_name(batch), finger].append((batch.time, values))
        self._rows += len(batch)
        self.end = max(self.end, int(batch.time.max(initial=self.start)))
        if self._rows > ROWS_MAX or len(self._events) > EVENTS_MAX:
            most = f"{ROWS_MAX:,} rows and {EVENTS_MAX:,} events"
            raise InputError(self._session, f"is too long for a page, which shows at most {most}")
        return True

    async def close(self) -> None:
        """Join the batches."""
        for key, parts in self._arriving.items():
            joined = np.concatenate([time for time, _ in parts]), np.concatenate([each for _, each in parts])
            if key[0] == "label":
                self.bands[key] = self._runs(*joined)
            else:
                self.curves[key] = joined
        for finger, truths in self._truth.items():
            truth = concat(Truth, truths)
            code = np.full(len(truth), STATIC, np.int8)
            for onset, end in true_slips(truth):
                code[(truth.time >= onset) & (truth.time <= end)] = SLIP
            self.bands["truth", finger] = self._runs(truth.time, code)
        self._arriving.clear()
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
            "scored": bool(self._scores()),
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
        for finger, curve in self._scores().items():
            events.extend((finger, slip) for slip in slips(rule.reset_copy().push(Scores(*curve))))
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

        scores = {finger: values[row(time)] for finger, (time, values) in self._scores().items()}
        return {
            "rows": self._cut(newest),
            "faults": faults_json({finger: self._faults_at(finger, at) for finger in self._faults}),
            "quality": {
                finger: quality_json(each.item(), self._faults_at(finger, at))
                for finger, each in scores.items()
                if len(each)
            },
        }

    def _scores(self) -> dict[str, tuple[Times, Values]]:
        """Return times and probabilities by fingertip."""
        return {finger: curve for (stream, finger), curve in self.curves.items() if stream == "scores"}

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
