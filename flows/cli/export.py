"""The command `slipflow export`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.options import DatasetOrSession
from flows.cli.terminal import note, progress_bar
from flows.report.table import counted

if TYPE_CHECKING:
    from storage import Session

_FORMATS = ("lerobot", "mcap")


def export(
    source: DatasetOrSession,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="New folder; FILE.mcap for one session.")],
    *,
    to: Annotated[
        str, typer.Option("--to", metavar="FORMAT", help="lerobot (LeRobot v3.0) or mcap (Foxglove).")
    ],
    rate: Annotated[
        int | None,
        typer.Option(
            min=1, help="Frames per second, with --to lerobot (default: the lowest rate of the samples)."
        ),
    ] = None,
) -> None:
    """Export recordings to LeRobot or MCAP.

    lerobot: each session becomes an episode. The observation has the zeroed counts of all fingertips, the
    action is the velocity of the arm. Each frame takes the nearest sample; without one it repeats the values
    before it, with `valid` false. Sessions without samples, which `slipflow run record` writes, are left out.

    mcap: one file per session, with all rows on the topics /touch/FINGER, /motion, /samples/FINGER,
    /slip/FINGER and /faults. Requires the extra `mcap`.

    Examples:
      slipflow export recordings lerobot --to lerobot --rate 50
      slipflow export recordings/sessions/stroke-9 stroke.mcap --to mcap
    """
    if to not in _FORMATS:
        raise typer.BadParameter(f"--to {to}: give lerobot or mcap")
    if rate is not None and to != "lerobot":
        raise typer.BadParameter(f"--rate requires --to lerobot: omit it with --to {to}")
    typer.echo(_lerobot(source, out, rate) if to == "lerobot" else _mcap(source, out))


def _sessions(path: Path) -> "list[Session]":
    from storage import Session
    from storage.layout import session_folders

    # opening a dataset without sessions raises an error that says so
    return [Session.open(each) for each in session_folders(path) or [path]]


def _lerobot(source: Path, out: Path, rate: int | None) -> str:
    """Write a dataset of all sessions with samples, and return what it has."""
    from operators import Labelled
    from storage.exports.lerobot import export as write

    found = _sessions(source)
    sessions = [each for each in found if each.fingers(Labelled)] or found  # none: an error that says so
    if left_out := [each.name for each in found if each not in sessions]:
        note(f"without samples, so left out: {', '.join(left_out)}")
    with progress_bar("exporting") as update:
        done = write(
            sessions, out, rate=rate, progress=lambda number, name: update(number, len(sessions), name)
        )
    splits = ", ".join(f"{split} {span}" for split, span in done.splits.items())
    lines = [
        f"{counted(done.episodes, 'episode')} ({splits})",
        f"{counted(done.frames, 'frame')} at {done.rate} Hz of {', '.join(done.features)}",
        f"{counted(done.repeated, 'frame')} without a sample: values repeated, valid false",
        f"wrote {out}",
    ]
    return "\n".join(lines)


def _mcap(source: Path, out: Path) -> str:
    """Write a file for each session, and return their names and rows."""
    from storage.exports import mcap_file

    sessions = _sessions(source)
    files, single = dict[Path, int](), len(sessions) == 1 and out.suffix == ".mcap"
    with progress_bar("exporting") as update:
        for number, session in enumerate(sessions):
            update(number, len(sessions), session.name)
            path = out if single else out / f"{session.name}.mcap"
            files[path] = sum(mcap_file.export(session, path).values())
    size = f"{counted(len(files), 'file')}, {counted(sum(files.values()), 'row')}"
    return f"{size}\nwrote {', '.join(map(str, files))}"
