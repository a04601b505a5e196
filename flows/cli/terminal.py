"""Output of the commands: log of a run, notes, progress and reports.

The log has text lines on stderr, or one JSON object per line on stdout.
"""

import json
import logging
import re
import shlex
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Final, TextIO

import typer

if TYPE_CHECKING:
    from flows.report.report_page import Report
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


def begin_log(form: Format = Format.TEXT) -> None:
    """Send log records to stderr as text, or to stdout as JSON."""
    logging.getLogger("slipflow.compilation").setLevel(logging.INFO)  # the user has to wait for it
    logging.getLogger("slipflow.models").setLevel(logging.INFO)  # a model is for one task only
    handler: logging.Handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    if form is Format.JSON:
        handler = PipeHandler(sys.stdout)
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


def note(text: str) -> None:
    """Print a message on stderr, as stdout is for the result; a JSON log gets it as a record."""
    if any(isinstance(each.formatter, JsonFormatter) for each in logging.root.handlers):
        message = text.removeprefix("error: ")
        log.log(logging.INFO if message == text else logging.ERROR, "%s", message)
    else:
        typer.echo(text, err=True)


def check_output_file(path: Path) -> None:
    """Require that a file can be created at `path`: its folder exists, and `path` is not a folder.

    Raises:
        EndpointError: if it cannot.
    """
    from operators.errors import EndpointError

    if not path.parent.is_dir():
        raise EndpointError(str(path), f"folder {path.parent} does not exist: create it, or write elsewhere")
    if path.is_dir():
        raise EndpointError(str(path), "is a folder: give a file name")


@contextmanager
def progress_bar(action: str) -> Generator[Callable[..., None]]:
    """Show a progress bar on stderr if it is a terminal; yield the callback that updates it.

    Its arguments are the finished steps, all steps (None: of unknown number), and the part in progress.
    """
    from rich import progress
    from rich.console import Console

    more = progress.MofNCompleteColumn(), progress.TimeElapsedColumn()
    columns, console = (*progress.Progress.get_default_columns(), *more), Console(stderr=True)
    hidden = not console.is_terminal
    with progress.Progress(*columns, console=console, transient=True, disable=hidden) as bar:
        task = bar.add_task(action)

        def update(done: int, total: int | None, part: str = "") -> None:
            bar.update(task, description=f"{action} {part}".rstrip(), completed=done, total=total)

        yield update


def command_line() -> str:
    """Return the command that the user typed, for a report."""
    return shlex.join(["slipflow", *sys.argv[1:]])


def prepare_report(folder: Path) -> None:
    """Check the folder of a report before a long measurement; note that figures need matplotlib."""
    from flows.report.figures import missing_matplotlib
    from flows.report.report_page import check_output_folder

    check_output_folder(folder)
    if reason := missing_matplotlib():
        note(f"the report will have no figures, which {reason}")


def write_report(report: "Report", folder: Path, name: str, *, as_json: bool) -> None:
    """Write a report as NAME.html, .md, .json and figures; print its tables."""
    paths = report.write(folder, name)
    note(f"wrote {', '.join(map(str, paths))}")
    typer.echo(json.dumps(report.json(), allow_nan=False) if as_json else report.terminal())
