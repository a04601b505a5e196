"""The command `slipflow verify`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from flows.cli.options import DatasetOrSession
from flows.cli.terminal import note, progress_bar
from flows.report.table import counted

if TYPE_CHECKING:
    from storage import Recovery, Verified

_VERDICTS: Final = {
    "note": "all data is present",
    "repairable": "repairable, all rows on disk can be recovered: add --repair",
    "repaired": "repaired, all rows on disk were recovered",
    "lossy": "rows are known to be missing",
    "lost": "recorded data is lost",
}


def verify(
    path: DatasetOrSession,
    *,
    repair: Annotated[
        bool, typer.Option("--repair", help="First repair sessions whose recorder was killed.")
    ] = False,
) -> None:
    """Read all data of a dataset and report losses and damage.

    Compares every file with the manifest: SHA-256, page checksums, rows and times. A recording in progress is
    checked up to its last commit. Changes nothing without --repair, which moves the rows of a killed
    recorder's journal into the dataset, as opening such a session with slipflow does, and damaged or unknown
    files of the session into its folder `damaged`.

    Exits 0 if the data is complete; 3 if something was or can be repaired without loss of rows on disk, or
    rows are known to be missing (for example dropped ones); 1 if recorded data is lost or damaged, even after
    a repair. The rows that a killed recorder could not write, for example because the disk was full, are
    unknown.

    Examples:
      slipflow verify recordings
      slipflow verify recordings/sessions/stroke-9 --repair
    """
    from storage import verify as check

    repaired = _repair(path) if repair else []
    with progress_bar("verifying") as update:
        found = check(path, update)
    lines = list[str]()
    for each in repaired:
        rows = ", ".join(f"{count:,} rows of {table}" for table, count in each.rows.items()) or "no rows"
        lines.append("; ".join([f"{each.session}: recovered {rows}", *each.done]))
    for line in (*lines, *_lines(path, found)):  # control characters of a name are printed as escapes
        typer.echo("".join(char if char.isprintable() else repr(char)[1:-1] for char in line))
    if found.code:
        raise typer.Exit(found.code)


def _repair(path: Path) -> "list[Recovery]":
    """Recover the sessions that need it; sessions that are being recorded or cannot be recovered stay."""
    from operators.errors import SlipflowError
    from storage import recover
    from storage.layout import session_folders

    done, folders = list["Recovery"](), session_folders(path)
    with progress_bar("repairing") as update:
        for number, folder in enumerate(folders, 1):
            try:
                done.append(recover(folder))
            except SlipflowError as error:
                note(f"not repaired: {error}")
            update(number, len(folders))
    return [each for each in done if each.changed]


def _lines(path: Path, found: "Verified") -> list[str]:
    width = max((len(each.weight) for each in found.findings), default=0)
    lines = [
        f"{each.weight:{width}}  {each.session}: {each.text}".replace(" : ", " ") for each in found.findings
    ]
    counts = (found.sessions, "session"), (found.files, "file"), (found.rows, "row")
    size = ", ".join(counted(*each) for each in counts)
    return [*lines, f"{path}: {size}: {_VERDICTS[found.worst]}"]
