"""Log of a run: text lines on stderr, or one JSON object per line on stdout."""

import logging
import re
import sys
from collections.abc import Generator
from contextlib import contextmanager
from enum import StrEnum
from typing import TYPE_CHECKING, Final, TextIO

if TYPE_CHECKING:
    from operators.ports import Json, Run

_SECRET: Final = re.compile(r"""(?<=://)[^/\s"'@]+(?=@)|(?<=[?&]token=)[^&\s"']+""")  # in URLs

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
    logging.basicConfig(handlers=[handler])


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
