"""Page of a recorded session: its curves, events at another threshold, labels by hand."""

import asyncio
import json
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, replace
from time import time_ns
from typing import Any, Final, TypeAlias

import numpy as np
from aiohttp import web
from numpy.typing import NDArray

from connectors.events import Slip, encode, finger_name, slips
from connectors.web.curves import GAP, curve_json, event_json, join_rows, plotted, thin_curve
from connectors.web.web_server import PAGE_FILES, Handler
from operators import Debounce
from operators.batch import EVERY, Codes, Labelled, Motion, Scores, Slips, Times, Touch, Zeroed, ms
from operators.errors import InputError
from operators.ports import Json, Run, Sink
from storage import HandLabels, LabelSpan, Session

ROWS_MAX: Final = 20_000_000  # of all streams together, about 1 GB
Values: TypeAlias = NDArray[Any]  # (n, ...) of a curve
_Event: TypeAlias = tuple[str, Slip]  # with its fingertip
_TIME_MAX: Final = 1e12  # ms
_COLUMNS_MAX: Final = 8192
_VALID_FOR: Final = 1000  # ms, maximum age of a row at the selected time
_LABELS_USAGE: Final = (
    'must be {"based_on": VERSION, "spans": [{"begin": MS, "end": MS, "finger": NAME, "value": '
    '"slip", "author": TEXT, "note": TEXT, "created": NS as text or ""}, ...]}'
)


class SessionPage(Sink[Zeroed | Motion | Scores | Slips]):
    """Page of a recorded session: keeps a replay of it in memory, and answers requests.

    Labelled touch becomes the band ``label``; touch without labels becomes curves.

    Args:
        session: Session; its labels by hand are shown and written.
        rule: Rule of `detected`; the page marks its threshold.
        detector: Name of the detector that computes the scores; None: there are none.
        recorded: True if the slips are recorded ones, False if found now.

    Attributes:
        curves: Times and values by stream and fingertip, such as ``touch 0``, once closed.
        bands: Runs of equal labels, as [begin, end, code] with times in ms since the start, once closed.
    """

    def __init__(self, session: Session, rule: Debounce, detector: str | None, *, recorded: bool) -> None:
        self.session, self.rule, self.detector, self.recorded = session, rule, detector, recorded
        self.start = self.end = 0  # ns, start of the run and newest row
        self._arriving = defaultdict[str, list[tuple[Times, Values]]](list)  # joined in `close`
        self.curves: dict[str, tuple[Times, Values]] = {}
        self.bands: dict[str, Json] = {}
        self._events: list[_Event] = []
        self._rows = 0

    @property
    def destination(self) -> str:
        """Constant name of the memory of this process."""
        return "memory"

    async def open(self, run: Run) -> None:
        """Set the start of `run`."""
        self.start = run.start

    def take(self, batch: Zeroed | Motion | Scores | Slips) -> bool:
        """Keep the rows of a batch.

        Raises:
            InputError: if the session has too many rows.
        """
        finger = finger_name(batch.finger)
        match batch:
            case Slips():
                self._events.extend((finger, slip) for slip in slips(batch))
            case Labelled():
                self._arriving[f"label {finger}"].append((batch.time, batch.label))
            case Scores():  # exact, as they are detected again
                self._arriving[f"scores {finger}"].append((batch.time, batch.probability))
            case _:
                name, values = plotted(batch)
                self._arriving[name].append((batch.time, values.astype(np.float32)))
        self._rows += len(batch)
        self.end = max(self.end, int(batch.time.max(initial=self.start)))
        if self._rows > ROWS_MAX:
            text = f"is too long for a page, which shows at most {ROWS_MAX:,} rows"
            raise InputError(self.session.name, text)
        return True

    async def close(self) -> None:
        """Join the batches in order of time."""
        for name, parts in self._arriving.items():
            joined = join_rows(parts)
            if name.startswith("label "):
                self.bands[name] = self._runs(*joined)
            else:
                self.curves[name] = joined
        self._arriving.clear()

    @property
    def routes(self) -> tuple[web.AbstractRouteDef, ...]:
        """Requests of the page; a POST request stores the next version of the labels by hand."""
        return (
            *PAGE_FILES,
            web.get("/about.json", _handler(lambda *_: self.contents())),
            web.get("/window", _handler(self._window)),
            web.get("/events", _handler(lambda request, _: self.detected(_number(request, "threshold")))),
            web.post("/labels", _handler(self._write_labels)),
        )

    def contents(self) -> dict[str, Json]:
        """Return the first document of the page; times are in ms since `start`."""
        fingertip = self.session.fingertip(Touch)
        return {
            "mode": "recorded",
            "session": self.session.name,
            "fingertip": fingertip.describe() if fingertip else None,
            "detector": self.detector,
            "recorded": self.recorded,
            "start": self.start / ms,
            "length": 10 * ((self.end - self.start) // (10 * ms) + 1),  # a step of the slider after it
            "threshold": self.rule.threshold,
            "events": self._events_json(self._events),
            "bands": self.bands,
            "labels": self._labels_json(self.session.hand_labels()),
        }

    def detected(self, threshold: float) -> list[Json]:
        """Return the events that the debounce finds in the scores at another threshold.

        Raises:
            ParameterError: if the threshold is not above 0 and at most 1.
        """
        rule, events = replace(self.rule, threshold=threshold), list[_Event]()
        for name, curve in self.curves.items():
            if name.startswith("scores "):
                found = rule.reset_copy().push(Scores(*curve))
                events.extend((name.removeprefix("scores "), slip) for slip in slips(found))
        return self._events_json(events)

    def window(self, begin: float, end: float, columns: int | None) -> dict[str, Json]:
        """Return the curves from `begin` to `end` (ms since `start`), by stream and fingertip.

        Curves are reduced to the minimum and maximum of each of `columns` pixel columns, or to the newest row
        if `columns` is None.
        """
        first, last = (self.start + round(each * ms) for each in (begin, end))
        rows = dict[str, Json]()
        for name, (times, every) in self.curves.items():
            part = slice(*np.searchsorted(times, [first, last + 1]))
            time, values = times[part], every[part]
            newest = time[-1:], values[-1:]
            thin = thin_curve(time, values, first, last, columns) if columns else newest
            rows[name] = curve_json(*thin, self.start)
        return rows

    def _events_json(self, events: list[_Event]) -> list[Json]:
        """Return events in order of time; fingertips are written one after the other."""
        ordered = sorted(events, key=lambda event: event[1].time)
        return [
            event_json(number, finger, slip, self.start) for number, (finger, slip) in enumerate(ordered, 1)
        ]

    def _runs(self, time: Times, code: Codes) -> list[Json]:
        """Return the runs of equal codes of rows in order of time; a pause of more than 250 ms ends a run."""
        pauses = np.append(np.diff(time) > GAP, np.True_)
        last = np.flatnonzero(np.append(np.diff(code) != 0, np.True_) | pauses)[: len(time)]
        first = np.append(0, last + 1)[: len(last)]
        ends = time[np.where(pauses[last], last, np.minimum(last + 1, len(time) - 1))]
        begin, end = (((each - self.start) / ms).round(3).tolist() for each in (time[first], ends))
        return [list(run) for run in zip(begin, end, code[first].tolist(), strict=True)]

    def _window(self, request: web.Request, _: bytes) -> Json:
        begin, end, at, columns = (_number(request, name) for name in ("begin", "end", "at", "columns"))
        if not (begin <= end and 1 <= columns <= _COLUMNS_MAX):
            raise InputError(request.path, f"must have begin <= end, and 1 to {_COLUMNS_MAX} columns")
        return {"rows": self.window(begin, end, int(columns)), "at": self.window(at - _VALID_FOR, at, None)}

    def _write_labels(self, _: web.Request, body: bytes) -> Json:
        now = str(time_ns())
        try:
            content: Any = json.loads(body)
            based_on: int = content["based_on"]
            spans = [
                LabelSpan(
                    **{
                        **each,
                        "begin": self.start + round(float(each["begin"]) * ms),
                        "end": self.start + round(float(each["end"]) * ms),
                        "finger": EVERY if each["finger"] == finger_name(EVERY) else int(each["finger"]),
                        "created": int(each["created"] or now),
                    }
                )
                for each in content["spans"]
            ]
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            raise InputError("/labels", _LABELS_USAGE) from None
        return self._labels_json(self.session.write_hand_labels(spans, based_on=based_on))

    def _labels_json(self, labels: HandLabels) -> dict[str, Json]:
        """Return labels by hand: times in ms since the start, `created` as text as it exceeds a double."""
        spans: list[Json] = [
            {
                **asdict(span),
                "begin": (span.begin - self.start) / ms,
                "end": (span.end - self.start) / ms,
                "finger": finger_name(span.finger),
                "created": str(span.created),
            }
            for span in labels.spans
        ]
        return {"version": labels.version, "spans": spans}


def _handler(document: Callable[[web.Request, bytes], Json]) -> Handler:
    """Return the handler that answers a request and its body with a document, built in a thread."""

    async def handle(request: web.Request) -> web.Response:
        body = await request.read()
        text = await asyncio.to_thread(lambda: encode(document(request, body)))
        return web.Response(body=text, content_type="application/json")

    return handle


def _number(request: web.Request, name: str) -> float:
    """Return a number of a query."""
    with suppress(KeyError, ValueError):
        value = float(request.query[name])
        if abs(value) <= _TIME_MAX:  # also for NaN
            return value
    raise InputError(request.path, f"must have {name}, a number")
