"""Requests of the page of a recorded session: its curves, events at another threshold, labels by hand."""

import asyncio
import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from time import time_ns
from typing import Any, Final

from aiohttp import web

from connectors.events import finger_name
from connectors.web.session_curves import SessionCurves
from connectors.web.web_server import PAGE_FILES, Handler, json_response
from operators.batch import EVERY, ms
from operators.errors import InputError, ParameterError
from operators.ports import Json
from storage import HandLabels, LabelSpan, Session

_TIME_MAX: Final = 1e12  # ms
_COLUMNS_MAX: Final = 8192
_VALID_FOR: Final = 1000  # ms, maximum age of a row at the selected time
_LABELS_USAGE: Final = (
    'must be {"based_on": VERSION, "spans": [{"begin": MS, "end": MS, "finger": NAME, "value": '
    '"slip", "author": TEXT, "note": TEXT, "created": NS as text or ""}, ...]}'
)


class SessionPage:
    """Answers to the requests of the page of a recorded session.

    Args:
        curves: Curves and events.
        session: Session whose labels by hand the page shows and writes.
    """

    def __init__(self, curves: SessionCurves, session: Session) -> None:
        self.curves, self.session = curves, session

    @property
    def routes(self) -> tuple[web.AbstractRouteDef, ...]:
        """Requests of the page; a POST request stores the next version of the labels by hand."""
        return (
            *PAGE_FILES,
            web.get("/about.json", _handler(self._about)),
            web.get("/window", _handler(self._window)),
            web.get("/events", _handler(self._events)),
            web.post("/labels", _handler(self._write_labels)),
        )

    def _about(self, _: web.Request, __: bytes) -> Json:
        labels = self._labels_json(self.session.hand_labels())
        return {"mode": "recorded", "labels": labels, **self.curves.contents()}

    def _window(self, request: web.Request, _: bytes) -> Json:
        begin, end, at, columns = (_number(request, name) for name in ("begin", "end", "at", "columns"))
        if not (begin <= end and 1 <= columns <= _COLUMNS_MAX):
            raise InputError(request.path, f"must have begin <= end, and 1 to {_COLUMNS_MAX} columns")
        shown = self.curves.window(begin, end, int(columns))
        return {"rows": shown["rows"], "at": self.curves.window(at - _VALID_FOR, at, None)}

    def _events(self, request: web.Request, _: bytes) -> Json:
        return self.curves.detected(_number(request, "threshold"))

    def _write_labels(self, _: web.Request, body: bytes) -> Json:
        based_on, spans = self._spans(body)
        return self._labels_json(self.session.write_hand_labels(spans, based_on=based_on))

    def _spans(self, body: bytes) -> tuple[int, list[LabelSpan]]:
        """Return the contents of a request to write labels by hand.

        Raises:
            InputError: if it is malformed.
            ParameterError: if a span is invalid.
        """
        now = str(time_ns())
        try:
            content: Any = json.loads(body)
            based_on: int = content["based_on"]
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
                for each in content["spans"]
            ]
        except ParameterError:
            raise
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            raise InputError("/labels", _LABELS_USAGE) from None
        return based_on, spans

    def _labels_json(self, labels: HandLabels) -> dict[str, Json]:
        """Return labels by hand: times in ms since the start, `created` as text as it exceeds a double."""
        spans: list[Json] = [
            {
                **asdict(span),
                "begin": (span.begin - self.curves.start) / ms,
                "end": (span.end - self.curves.start) / ms,
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
        return await asyncio.to_thread(lambda: json_response(document(request, body)))

    return handle


def _number(request: web.Request, name: str) -> float:
    """Return a number of a query.

    Raises:
        InputError: if it is missing or too large.
    """
    with suppress(KeyError, ValueError):
        value = float(request.query[name])
        if abs(value) <= _TIME_MAX:  # also for NaN
            return value
    raise InputError(request.path, f"must have {name}, a number")
