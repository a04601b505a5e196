"""Output of commands that write a report, and their shared option."""

import json
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.terminal import note

if TYPE_CHECKING:
    from flows.report.report_page import Report

ReportFolder = Annotated[Path, typer.Option(metavar="DIR", help="Folder of the report.")]


def command_line() -> str:
    """Return the command that the user typed, for a report."""
    return shlex.join(["slipflow", *sys.argv[1:]])


def prepare_report(folder: Path) -> None:
    """Check that a report can be written to a folder, before a long measurement.

    Notes that figures need matplotlib. A measurement that fails leaves no empty folder.

    Raises:
        EndpointError: if the folder cannot be created or written.
    """
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
