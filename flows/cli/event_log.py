"""What happens in a run as a log: lines for people, or one JSON object a line on stdout."""

import logging
import re
import sys
from collections.abc import Generator
from contextlib import contextmanager
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, Final, TextIO

import typer

if TYPE_CHECKING:
    from flows.graph import Flow
    from flows.graph.node import Node, Part
    from operators.ports import Json, Run

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415

_SECRET: Final = re.compile(r"""(?<=://)[^/\s"'@]+(?=@)|(?<=[?&]token=)[^&\s"']+""")  # within addresses

log = logging.getLogger("slipflow")


class Format(StrEnum):
    """What a log looks like."""

    TEXT = "text"
    JSON = "json"


Log = Annotated[
    Format,
    typer.Option(
        "--log",
        help="json: print each event as one JSON object a line: slips, failures, the run's begin and end.",
    ),
]


class JsonLines(logging.Formatter):
    """A log record as one line of JSON: time (UTC), event, level, what the event tells.

    A record that names no event becomes an event called `log`, with its text. Credentials in addresses
    are left out.

    >>> about = {"msg": "cannot reach mqtt://me:secret@host", "created": 5, "levelname": "INFO"}
    >>> print(JsonLines().format(logging.makeLogRecord(about)).partition(",")[2])
    "event":"log","level":"info","message":"cannot reach mqtt://...@host"}
    """

    def format(self, record: logging.LogRecord) -> str:
        """Make the line."""
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


class Printed(logging.StreamHandler[TextIO]):
    """Writes log lines to a stream, and is silent when its reader has gone, as `| head` does."""

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - logging's name
        """Report any other failure to write."""
        if not isinstance(sys.exc_info()[1], BrokenPipeError):
            super().handleError(record)


def begin_log(form: Format, stream: TextIO | None = None) -> None:
    """Let what happens be told: to people on stderr, to programs on `stream`, by default stdout."""
    if form is Format.TEXT:
        logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", stream=sys.stderr)
        return
    handler = Printed(stream or sys.stdout)
    handler.setFormatter(JsonLines())
    logging.basicConfig(handlers=[handler])
    log.setLevel(logging.INFO)


def in_json(flow: "Flow") -> "Flow":
    """The same flow, its consoles printing JSON; if it has none, one takes its first slips and faults."""
    from connectors import Console
    from operators import Faults, Slips

    def choose(node: "Node") -> "Part":
        return Console(node.part.stream, "json") if isinstance(node.part, Console) else node.part

    told = flow.replaced(choose)
    if not any(isinstance(node.part, Console) for node in told.nodes):
        console = Console(format="json")
        for kind in (Slips, Faults):
            first = next((node for node in told.nodes if node.gives is kind), None)
            if first is not None:
                told.add_sink(console, first)
    return told


@contextmanager
def logged(run: "Run") -> Generator[None]:
    """Tell when a run begins and what it came to."""
    from flows.run.log_events import event

    names: dict[str, Json] = {"sources": [*run.sources], "sinks": [*run.sinks]}
    about: dict[str, Json] = {"live": run.live, "recording": run.recording, **names}
    begins = event("run_begins", session=run.session, flow=run.flow, **about)
    log.info("%s begins", run.session, extra=begins)
    try:
        yield
    finally:
        log.info("%s ends", run.session, extra=_end(run))


def _end(run: "Run") -> "dict[str, Any]":
    from flows.run.log_events import event

    seconds = (run.clock.now() - run.start) / 1e9
    sources: dict[str, Json] = {
        name: {
            "rows": source.rows,
            "late": source.late,
            "failures": source.failures,
            "gaps": len(source.gaps),
            "error": source.error or None,
        }
        for name, source in run.sources.items()
    }
    sinks: dict[str, Json] = {
        name: {
            "rows": sink.rows,
            "dropped": sink.dropped,
            "failures": sink.failures,
            "error": sink.error or None,
        }
        for name, sink in run.sinks.items()
    }
    return event(
        "run_ends",
        session=run.session,
        seconds=seconds,
        sources=sources,
        sinks=sinks,
        error=run.error or None,
    )
