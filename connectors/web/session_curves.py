"""Curves, labels and events of a recorded session, kept in memory for its page."""

from bisect import bisect_right
from collections import defaultdict
from dataclasses import replace
from operator import itemgetter
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from connectors.events import Fault, Slip, faults, finger_name, quality, slips
from connectors.sim.simulated_rig import true_slips
from connectors.web.curves import (
    GAP,
    curve_json,
    event_json,
    faults_json,
    page_fingertip,
    plotted,
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
)
from operators.errors import InputError
from operators.ports import Json, Run, Sink

ROWS_MAX: Final = 20_000_000  # of all streams together, about 1 GB
Values: TypeAlias = NDArray[Any]  # (n, ...) of a curve
_Event: TypeAlias = tuple[str, Slip]  # with its fingertip


class SessionCurves(Sink[Zeroed | Motion | Scores | Slips | Faults | Truth]):
    """Sink that keeps the curves, events and labels of a replay in memory.

    Labelled touch and truth become the bands ``label`` and ``truth``; touch without labels becomes curves.

    Args:
        rule: Rule of `detected`; the page marks its threshold.
        about: Text for the page.

    Attributes:
        curves: Times and values by stream and fingertip, such as ``touch 0``, once closed.
        bands: Runs of equal labels, as [begin, end, code] with times in ms since the start, once closed.
    """

    def __init__(self, rule: Debounce, about: str) -> None:
        self.rule, self.about = rule, about
        self.start = self.end = 0  # ns, start of the run and newest row
        self._arriving = defaultdict[str, list[tuple[Times, Values]]](list)  # joined in `close`
        self.curves: dict[str, tuple[Times, Values]] = {}
        self._truth = defaultdict[str, list[Truth]](list)  # by fingertip
        self.bands: dict[str, Json] = {}
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
            InputError: if the session has too many rows.
        """
        finger = finger_name(batch.finger)
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
            self._arriving[f"label {finger}"].append((batch.time, batch.label))
        else:
            name, values = plotted(batch)  # scores stay exact, as they are detected again
            kept = values if isinstance(batch, Scores) else values.astype(np.float32)
            self._arriving[name].append((batch.time, kept))
        self._rows += len(batch)
        self.end = max(self.end, int(batch.time.max(initial=self.start)))
        if self._rows > ROWS_MAX:
            text = f"is too long for a page, which shows at most {ROWS_MAX:,} rows"
            raise InputError(self._session, text)
        return True

    async def close(self) -> None:
        """Join the batches."""
        for name, parts in self._arriving.items():
            joined = np.concatenate([time for time, _ in parts]), np.concatenate([each for _, each in parts])
            if name.startswith("label "):
                self.bands[name] = self._runs(*joined)
            else:
                self.curves[name] = joined
        for finger, truths in self._truth.items():
            truth = concat(Truth, truths)
            code = np.full(len(truth), STATIC, np.int8)
            for onset, end in true_slips(truth):
                code[(truth.time >= onset) & (truth.time <= end)] = SLIP
            self.bands[f"truth {finger}"] = self._runs(truth.time, code)
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
            "bands": self.bands,
        }

    def detected(self, threshold: float) -> list[Json]:
        """Return the events that the debounce finds in the scores at another threshold.

        Raises:
            ParameterError: if the threshold is not above 0 and at most 1.
        """
        rule, events = replace(self.rule, threshold=threshold), list[_Event]()
        for finger, curve in self._scores().items():
            events.extend((finger, slip) for slip in slips(rule.reset_copy().push(Scores(*curve))))
        return self._events_json(events)

    def window(self, begin: float, end: float, columns: int | None) -> dict[str, Json]:
        """Return the curves from `begin` to `end` (ms since `start`), and faults and quality at the end.

        Curves are reduced to the minimum and maximum of each of `columns` pixel columns, or to the newest row
        if `columns` is None.
        """
        first, last = (self.start + round(each * ms) for each in (begin, end))
        rows, qualities = dict[str, Json](), dict[str, Json]()
        for name, (times, every) in self.curves.items():
            part = slice(*np.searchsorted(times, [first, last + 1]))
            time, values = times[part], every[part]
            stream, _, finger = name.partition(" ")
            if stream == "scores" and len(time):
                qualities[finger] = quality(values.item(-1), self._faults_at(finger, last))
            thin = (
                (time[-1:], values[-1:])
                if columns is None
                else thin_curve(time, values, first, last, columns)
            )
            rows[name] = curve_json(*thin, self.start)
        current = {finger: self._faults_at(finger, last) for finger in self._faults}
        return {"rows": rows, "faults": faults_json(current), "quality": qualities}

    def _scores(self) -> dict[str, tuple[Times, Values]]:
        """Return times and probabilities by fingertip."""
        names = [name for name in self.curves if name.startswith("scores ")]
        return {name.removeprefix("scores "): self.curves[name] for name in names}

    def _faults_at(self, finger: str, time: int) -> frozenset[Fault]:
        known = self._faults.get(finger, [])
        row = bisect_right(known, time, key=itemgetter(0))
        return known[row - 1][1] if row else frozenset()

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
