"""The command `slipflow export`."""

import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flows.cli.options import AsJson
from flows.cli.terminal import check_output_file, note, progress_bar
from flows.report.table import counted

if TYPE_CHECKING:
    from storage import Session

_EXTRAS = {"lerobot": "", "mcap": "mcap", "rrd": "rerun"}  # needed, by format


def export(
    dataset: Annotated[
        Path, typer.Argument(metavar="DATASET|SESSION", help="Folder of a dataset or session.")
    ],
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="New folder; for one session also FILE.mcap or FILE.rrd.")
    ],
    *,
    to: Annotated[
        str,
        typer.Option(
            "--to",
            help="Format: lerobot (LeRobot v3.0), mcap (Foxglove) or rrd (Rerun); mcap and rrd: one file per"
            " session.",
        ),
    ],
    rate: Annotated[
        int | None,
        typer.Option(
            min=1, help="Frames per second, with --to lerobot (default: the lowest rate of the samples)."
        ),
    ] = None,
    task: Annotated[
        str | None,
        typer.Option(
            help="Task description, with --to lerobot (default: the motion's name in the recording)."
        ),
    ] = None,
    native: Annotated[
        bool,
        typer.Option(
            "--native",
            help="With --to lerobot: also copy the recordings, at their own rate, into OUT/slipflow.",
        ),
    ] = False,
    detector: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Add the slip probability of this detector (name or .safetensors file), with --to rrd.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Export recordings to LeRobot, MCAP or Rerun.

    lerobot: each session becomes an episode. The observation is the zeroed counts of all fingertips, the
    action is the arm velocity. Each sample goes to the nearest frame and is never repeated; a gap splits the
    episode. Requires samples, which `slipflow run record` writes. With --native all rows remain available
    next to the frames: OUT/slipflow is a dataset of slipflow, identical bit by bit.

    mcap: every row of every stream at its event time, on the topics /touch/FINGER, /motion, /samples/FINGER,
    /slip/FINGER and /faults. Requires the extra `mcap`.

    rrd: counts, speed and, with --detector, slip probability as time series; slips and faults as a text log.
    Requires the extra `rerun` (490 MB).

    Examples:
      slipflow export recordings lerobot --to lerobot --rate 50
      slipflow export recordings/sessions/stroke-9 stroke.mcap --to mcap
    """
    from operators.extras import require_extra

    if to not in _EXTRAS:
        raise typer.BadParameter(f"--to {to}: give lerobot, mcap or rrd")
    if detector is not None and to != "rrd":
        raise typer.BadParameter(f"--detector requires --to rrd: omit it with --to {to}")
    if extra := _EXTRAS[to]:
        require_extra(extra, f"--to {to}")
    if native and to != "lerobot":
        raise typer.BadParameter(f"--native requires --to lerobot: omit it with --to {to}")
    sessions = _sessions(dataset)
    began = time.time_ns()  # after a recovery, which changes session.json
    if to == "lerobot":
        found, text = _lerobot(sessions, out, rate, task, native=native)
    else:
        found, text = _files(sessions, out, to, detector)
    for session in sessions:
        _mark(session, to, out, began)
    typer.echo(json.dumps({**found, "to": to, "out": str(out)}) if as_json else text)


def _mark(session: "Session", to: str, out: Path, began: int) -> None:
    """Mark a session as exported, for `slipflow prune --keep-unexported`; it may be on a read-only disk."""
    from operators.errors import os_error_reason
    from storage.retention import mark_exported

    try:
        mark_exported(session.folder, to, out, began)
    except OSError as error:
        note(f"{session.folder}: cannot be marked as exported: {os_error_reason(error)}")


def _sessions(dataset: Path) -> "list[Session]":
    from storage import Session
    from storage.layout import SESSION, session_folder, session_names

    names = [] if (dataset / SESSION).exists() else session_names(dataset)
    if not names:
        return [Session.open(dataset)]  # raises an error if it is not a session
    return [Session.open(session_folder(dataset, name)) for name in names]


def _lerobot(
    sessions: "list[Session]", out: Path, rate: int | None, task: str | None, *, native: bool
) -> tuple[dict[str, Any], str]:
    from storage.exports.lerobot import export as write

    with progress_bar("exporting") as update:
        done = write(
            sessions,
            out,
            rate=rate,
            task=task,
            native=native,
            progress=lambda number, name: update(number, len(sessions), name),
        )
    splits = ", ".join(f"{split} {span}" for split, span in done.splits.items())
    source = f"{counted(done.sessions, 'session')}, split at {counted(done.gaps, 'gap')}"
    frames = f"{counted(done.samples, 'sample')}: {counted(done.frames, 'frame')} at {done.rate} Hz"
    lines = [
        f"{source}: {counted(done.episodes, 'episode')} ({splits})",
        f"{frames} of {', '.join(done.features)}",
    ]
    if done.samples > done.frames:
        lines.append(
            f"{counted(done.samples - done.frames, 'sample')} omitted: incomplete (another fingertip or the"
            " arm velocity is missing), not the nearest to a frame, or isolated between gaps"
        )
    if native:
        lines.append(f"the recordings are in {out / 'slipflow'}")
    return asdict(done), "\n".join([*lines, f"wrote {out}"])


def _files(sessions: "list[Session]", out: Path, to: str, detector: str | None) -> tuple[dict[str, Any], str]:
    """Write a file for each session."""
    from storage import load_detector
    from storage.exports import mcap_file, rrd_file

    model = None if detector is None else load_detector(detector)
    files, single = dict[str, dict[str, int]](), len(sessions) == 1 and out.suffix == f".{to}"
    if single:
        check_output_file(out)
    with progress_bar("exporting") as update:
        for number, session in enumerate(sessions):
            name = session.name

            def progress(rows: int, number: int = number, name: str = name) -> None:
                update(number, len(sessions), f"{name}, {rows:,} rows")

            path = out if single else out / f"{name}.{to}"
            written = (
                mcap_file.export(session, path, progress)
                if to == "mcap"
                else rrd_file.export(session, path, model, progress)
            )
            files[str(path)] = dict(written)
    rows = sum(sum(topics.values()) for topics in files.values())
    text = f"{counted(len(files), 'file')}, {counted(rows, 'row')}\nwrote {', '.join(files)}"
    return {"files": files}, text
