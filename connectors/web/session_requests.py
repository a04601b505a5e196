"""Requests of the page of a recorded session: its curves, events at another threshold, labels by hand."""

import asyncio
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from time import time_ns
from typing import Any, Final, cast

from connectors.events import finger_name
from connectors.web.session_bands import SessionBands
from connectors.web.session_export import TYPES, export_mcap, export_table
from connectors.web.session_page import SessionCurves
from connectors.web.web_server import Answer, Handler, Writer, json_answer
from operators.batch import EVERY, ms
from operators.errors import InputError, ParameterError
from operators.ports import Json
from storage import HandLabels, LabelSpan, Session

_TIME_MAX: Final = 1e12  # ms
_COLUMNS_MAX: Final = 8192
_WINDOW_USAGE: Final = (
    "must be ?begin=MS&end=MS&at=MS&columns=N: ms since the start of the session; 1 to 8192 columns"
)
_EXPORT_USAGE: Final = (
    "must be ?begin=MS&end=MS&format=csv, parquet or mcap: ms since the start of the session"
)
_LABELS_USAGE: Final = (
    'must be {"based_on": VERSION, "spans": [{"begin": MS, "end": MS, "finger": NAME, "value": '
    '"slip", "author": TEXT, "note": TEXT, "created": NS as text or ""}, ...]}'
)


class SessionPage:
    """Data of the page of a recorded session.

    Args:
        curves: Curves and events.
        bands: Labels by arm speed and true sliding.
        session: Session whose labels by hand the page shows and writes; None: none.
        name: Title of the page in a comparison.
    """

    def __init__(
        self,
        curves: SessionCurves,
        bands: SessionBands | None = None,
        session: Session | None = None,
        name: str = "",
    ) -> None:
        self.curves, self.bands, self.session, self.name = curves, bands, session, name
        self.panes: Sequence[str] = (name,)  # titles of all pages that are compared

    def handlers(self, base: str = "") -> dict[str, Handler]:
        """Return the requests that read, by path below `base`: about.json, window, events and export.

        Documents are built in a thread, as that takes some ms.
        """
        found = {
            "about.json": self._about,
            "window": self._window,
            "events": self._events,
            "export": self._export,
        }
        return {f"{base}/{name}": handler for name, handler in found.items()}

    def writers(self, base: str = "") -> dict[str, Writer]:
        """Return the requests that write: ``/labels`` stores the next version of the labels by hand."""
        return {} if self.session is None else {f"{base}/labels": self._write_labels}

    async def _about(self, query: Mapping[str, str]) -> Answer:  # noqa: ARG002 - no parameters
        def document() -> Answer:
            labels = None if self.session is None else self._labels_json(self.session.hand_labels())
            about: dict[str, Json] = {"mode": "recorded", "panes": [*self.panes], "labels": labels}
            return json_answer({**about, **self.curves.contents()})

        return await asyncio.to_thread(document)

    async def _window(self, query: Mapping[str, str]) -> Answer:
        begin, end, at = (_number(query, name, "/window", _WINDOW_USAGE) for name in ("begin", "end", "at"))
        columns = int(_number(query, "columns", "/window", _WINDOW_USAGE))
        if not (begin <= end and 0 < columns <= _COLUMNS_MAX):
            raise InputError("/window", _WINDOW_USAGE)
        return await asyncio.to_thread(
            lambda: json_answer(
                {
                    **self.curves.window(begin, end, columns),
                    "at": self.curves.values_at(at),
                    "bands": self.bands.window(begin, end, columns) if self.bands else {},
                }
            )
        )

    async def _events(self, query: Mapping[str, str]) -> Answer:
        usage = "must be ?threshold=NUMBER, above 0 and at most 1"
        threshold = _number(query, "threshold", "/events", usage)
        if not 0 < threshold <= 1:
            raise InputError("/events", usage)
        return await asyncio.to_thread(lambda: json_answer([*self.curves.detected(threshold)]))

    async def _export(self, query: Mapping[str, str]) -> Answer:
        begin, end = (_number(query, name, "/export", _EXPORT_USAGE) for name in ("begin", "end"))
        kind, session, start = query.get("format", ""), self.session, self.curves.start
        if kind not in TYPES or begin > end or (kind == "mcap" and session is None):
            raise InputError("/export", _EXPORT_USAGE)
        span = start + round(begin * ms), start + round(end * ms)

        def body() -> bytes:
            if kind == "mcap" and session is not None:
                return export_mcap(session, span)
            labels = HandLabels() if session is None else session.hand_labels()
            return export_table(self.curves, self.bands, labels, span, kind)

        return await asyncio.to_thread(body), TYPES[kind]

    async def _write_labels(self, body: bytes) -> Answer:
        session = self.session
        assert session, "else there is no such request"

        def write() -> Answer:
            based_on, spans = self._spans(body)
            return json_answer(self._labels_json(session.write_hand_labels(spans, based_on=based_on)))

        return await asyncio.to_thread(write)

    def _spans(self, body: bytes) -> tuple[int, list[LabelSpan]]:
        """Return the contents of a request to write labels by hand.

        Raises:
            InputError: if it is malformed.
            ParameterError: if a span is invalid.
        """
        now = str(time_ns())
        try:
            content: Any = json.loads(body)
            based_on: object = content["based_on"]
            if not isinstance(based_on, int):
                raise TypeError("based_on")  # noqa: TRY301 - reported with all others
            spans = [
                LabelSpan(
                    self.curves.start + round(each["begin"] * ms),
                    self.curves.start + round(each["end"] * ms),
                    EVERY if each["finger"] == finger_name(EVERY) else int(each["finger"]),
                    value=str(each["value"]),
                    author=str(each["author"]),
                    note=str(each["note"]),
                    created=int(each["created"] or now),
                )
                for each in cast("list[dict[str, Any]]", content["spans"])
            ]
        except ParameterError:
            raise
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            raise InputError("/labels", _LABELS_USAGE) from None
        return based_on, spans

    def _labels_json(self, labels: HandLabels) -> dict[str, Json]:
        """Return labels by hand: times in ms since the start, `created` as text as it exceeds a double."""
        spans = [
            {
                **asdict(span),
                "begin": (span.begin - self.curves.start) / ms,
                "end": (span.end - self.curves.start) / ms,
                "finger": finger_name(span.finger),
                "created": str(span.created),
            }
            for span in labels.spans
        ]
        return {"version": labels.version, "spans": [*spans]}


def session_requests(pages: Sequence[SessionPage]) -> tuple[dict[str, Handler], dict[str, Writer]]:
    """Return the requests of pages side by side that read, and that write; those of page k are below /k."""
    handlers, writers = dict[str, Handler](), dict[str, Writer]()
    for number, page in enumerate(pages):
        page.panes = [each.name for each in pages]
        base = f"/{number}" if number else ""
        handlers |= page.handlers(base)
        writers |= page.writers(base)
    return handlers, writers


def _number(query: Mapping[str, str], name: str, where: str, usage: str) -> float:
    """Return a number of a query.

    Raises:
        InputError: if it is missing or too large.
    """
    try:
        value = float(query[name])
    except (KeyError, ValueError):
        raise InputError(where, usage) from None
    if not abs(value) <= _TIME_MAX:  # also for NaN
        raise InputError(where, usage)
    return value
