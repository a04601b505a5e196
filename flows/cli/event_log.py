"""Log of a run: text lines on stderr, or one JSON object per line on stdout."""

import logging
import re
import sys
from collections.abc import Generator
from contextlib import contextmanager
from enum import StrEnum
from typing import TYPE_CHECKING, Final, TextIO

if TYPE_CHECKING:
    from flows.graph import Flow
    from operators.ports import Json, Run

_SECRET: Final = re.compile(r"""(?<=://)[^/\s"'@]+(?=@)|(?<=[?&]token=)[^&\s"']+""")  # in URLs
_REPEAT_AFTER: Final = 10.0  # s

log = logging.getLogger("slipflow")


class Format(StrEnum):
    """Format of the log."""

    TEXT = "text"
    JSON = "json"


class JsonFormatter(logging.Formatter):
    """Formatter of log records as JSON: time (UTC), event, level and the fields of the event.

    A record without an event becomes the event `log` with its message. Credentials in URLs are removed.

    >>> fields = {"msg": "cannot reach mqtt://me:secret@host", "created": 5, "levelname": "INFO"}
    >>> print(JsonFormatter().format(logging.makeLogRecord(fields)).partition(",")[2])
    "event":"log","level":"info","message":"cannot reach mqtt://...@host"}
    """

    def format(self, record: logging.LogRecord) -> str:
        """Return the record as one line."""
        from connectors.events import encode, timestamp

        document: dict[str, Json] = {
            "time": timestamp(round(record.created * 1e9)),
            "event": getattr(record, "event", "log"),
            "level": record.levelname.lower(),
            **getattr(record, "about", {}),
        }
        if document["event"] == "log":
            document["message"] = record.getMessage()
        if record.exc_info:
            document["traceback"] = self.formatException(record.exc_info)
        return _SECRET.sub("...", encode(document).decode())


class PipeHandler(logging.StreamHandler[TextIO]):
    """Stream handler that ignores a closed pipe, as in ``slipflow ... | head``."""

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - logging's name
        """Report any other write error."""
        if not isinstance(sys.exc_info()[1], BrokenPipeError):
            super().handleError(record)


class RepeatFilter:
    """Filter of log records that passes records with the same first line at most once in 10 s."""

    def __init__(self) -> None:
        self._passed: dict[str, float] = {}  # time (s) of the newest record that passed, by first line

    def __call__(self, record: logging.LogRecord) -> bool:
        """Return True to pass a record; an event of a run always passes."""
        if hasattr(record, "event"):
            return True
        self._passed = {
            line: time for line, time in self._passed.items() if abs(record.created - time) < _REPEAT_AFTER
        }
        first = record.getMessage().partition("\n")[0]
        return self._passed.setdefault(first, record.created) == record.created


def begin_log(form: Format = Format.TEXT, stream: TextIO | None = None) -> None:
    """Send log records to stderr as text, or to `stream` (default stdout) as JSON."""
    logging.getLogger("slipflow.compilation").setLevel(logging.INFO)  # the user has to wait for it
    logging.getLogger("slipflow.models").setLevel(logging.INFO)  # a model is for one task only
    handler: logging.Handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    if form is Format.JSON:
        handler = PipeHandler(stream or sys.stdout)
        handler.setFormatter(JsonFormatter())
        log.setLevel(logging.INFO)
    handler.addFilter(RepeatFilter())
    logging.basicConfig(handlers=[handler])


def print_json(flow: "Flow") -> None:
    """Let the consoles of a flow print JSON; if it has none, add one for slips and faults."""
    from connectors import Console
    from operators import Faults, Slips

    consoles = [sink for sink in flow.sinks().values() if isinstance(sink, Console)]
    for each in consoles:
        each.format = "json"
    if not consoles:
        console = Console(format="json")
        for kind in (Slips, Faults):
            first = next((node for node in flow.nodes if node.gives is kind), None)
            if first is not None:
                flow.add_sink(console, first)


@contextmanager
def logged(run: "Run") -> Generator[None]:
    """Log the start of a run, and its result at the end with the level of its worst loss."""
    from flows.run.log_events import event, reason_of
    from flows.run.run_summary import Summary

    names: dict[str, Json] = {"sources": [*run.sources], "sinks": [*run.sinks]}
    about: dict[str, Json] = {"live": run.live, "recording": run.recording, **names}
    log.info("%s begins", run.session, extra=event("run_begins", session=run.session, flow=run.flow, **about))
    try:
        yield
    except Exception as error:
        run.error = run.error or reason_of(error)
        raise
    finally:
        if log.isEnabledFor(logging.INFO):  # a JSON log; after a text log, the command prints the error
            summary = Summary.of(run)
            log.log(summary.level, "%s ends", run.session, extra=event("run_ends", **summary.as_dict()))
