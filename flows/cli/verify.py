"""The command `slipflow verify`."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.options import AsJson, DatasetOrSession
from flows.cli.terminal import note, progress_bar

if TYPE_CHECKING:
    from storage import Verified


def verify(
    path: DatasetOrSession,
    *,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            "-o",
            metavar="FILE.html",
            help="Also write the result as a page; its folder must exist.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Read all files of a dataset and report losses and damage.

    Compares every file with the manifest: SHA-256, page checksums, rows and times. Changes nothing. During
    a recording it checks the committed part.

    Exits 0 if the data is complete; 3 if something was or can be repaired without loss of rows on disk, or
    rows are known to be missing (for example dropped ones); 1 if recorded data is lost or damaged, even after
    a recovery. With --json this is "code", and "worst" is good, repairable, repaired, lossy or lost. How many
    rows a killed recorder could not write, for example because the disk was full, is unknown.

    Examples:
      slipflow verify recordings -o report.html
      slipflow verify recordings/sessions/stroke-9 --json
    """
    from flows.cli import verification_page as page
    from storage import verify as check

    if report is not None:
        page.check_file(report)
    with progress_bar("verifying") as update:
        found = check(path, update)
    if report is not None:
        page.write(found, path, report)
        note(f"wrote {report}")
    typer.echo(json.dumps(page.summary(found)) if as_json else _text(path, found))
    if found.code:
        raise typer.Exit(found.code)


def _text(path: Path, found: "Verified") -> str:
    from flows.cli.verification_page import VERDICTS, size

    width = max((len(each.weight) for each in found.findings), default=0)
    lines = [
        f"{each.weight:{width}}  {each.session}: {each.text}".replace(" : ", " ") for each in found.findings
    ]
    return "\n".join([*lines, f"{path}: {size(found)}: {VERDICTS[found.worst]}"])
