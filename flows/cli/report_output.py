"""Output of commands that write a report, and their shared options."""

import json
from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.terminal import note

if TYPE_CHECKING:
    from flows.report.report_page import Report

Dataset = Annotated[Path, typer.Argument(metavar="DATASET", help="Labelled dataset with splits.")]
Budget = Annotated[
    float, typer.Option(min=0, help="Tune the debounce for at most this many false alarms per static minute.")
]
ReportFolder = Annotated[Path, typer.Option(metavar="DIR", help="Folder of the report.")]


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
    """Write a report as NAME.html, .md, .json and figures; print its findings and tables."""
    paths = report.write(folder, name)
    note(f"wrote {', '.join(map(str, paths))}")
    typer.echo(json.dumps(report.json(), allow_nan=False) if as_json else report.terminal())


def method_options(models: Sequence[Path], names: Sequence[str]) -> str:
    """Return the command-line options that select these models and methods, for the command in a report."""
    given = [*(f"--model {quote(str(path))}" for path in models), *(f"--method {name}" for name in names)]
    return "".join(f" {option}" for option in given)
