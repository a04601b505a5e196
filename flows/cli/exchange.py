"""The commands that trade recordings with other tools."""

import asyncio
import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flows.cli.options import AsJson, check_output_file, counted, progress_bar, told

if TYPE_CHECKING:
    from storage import Session

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415


def export(
    dataset: Annotated[
        Path, typer.Argument(metavar="DATASET", help="A dataset, or the folder of one of its sessions.")
    ],
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="A new folder; of one session, FILE.mcap or FILE.rrd.")
    ],
    *,
    to: Annotated[
        str,
        typer.Option(
            "--to",
            help="lerobot: LeRobot v3.0; mcap, for Foxglove, or rrd, for Rerun: a file for each session.",
        ),
    ],
    rate: Annotated[int, typer.Option(min=1, help="Frames per second, for lerobot.")] = 100,
    task: Annotated[
        str | None,
        typer.Option(
            help="What the arm does, for lerobot; by default what the recording says of its motion."
        ),
    ] = None,
    detector: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Scores the touch again, for rrd: built in, or a file of weights."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write recordings for other tools: LeRobot, MCAP, Rerun.

    lerobot: a session is an episode. The state is the zeroed counts of all fingertips, the action the arm's
    velocity; a sample goes to the nearest frame and is never repeated, and a gap cuts the episode in two.
    Needs samples, which `slipflow run record` makes.

    mcap: every row of every stream, at its event time, under /touch/FINGER, /motion, /samples/FINGER,
    /slip/FINGER, /faults. Needs the mcap extra.

    rrd: counts, speed and, with --detector, the probability of slip as time series; slips and faults as a
    text log. Needs the rerun extra, which installs 490 MB.
    """
    if to not in ("lerobot", "mcap", "rrd"):
        raise typer.BadParameter(f"--to {to}: give lerobot, mcap or rrd")
    if detector is not None and to != "rrd":
        raise typer.BadParameter(f"--detector is for --to rrd: leave it out with --to {to}")
    sessions = _sessions(dataset)
    if to == "lerobot":
        found, text = _lerobot(sessions, out, rate, task)
    else:
        found, text = _files(sessions, out, to, detector)
    typer.echo(json.dumps({**found, "to": to, "out": str(out)}) if as_json else text)


def import_(
    trace: Annotated[Path, typer.Argument(metavar="TRACE.csv", help="A trace of one fingertip.")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Dataset to write into; made if absent.")],
    *,
    columns: Annotated[
        str,
        typer.Option(
            "--map",
            metavar="NAME=COLUMNS,...",
            help="Which columns hold what: time=t,counts=p0..p5,speed=v,label=slip. Of time, counts (6),"
            " velocity (3 or 6), speed, label; what is left out is guessed from usual names, label= is none."
            " Names without numbers are listed: counts=left,right,top,bottom,tip,base.",
        ),
    ] = "",
    units: Annotated[
        str,
        typer.Option(
            metavar="NAME=UNIT,...",
            help="As time=ms,speed=mm/s. Of time: s, ms, us, ns; of velocity and speed: m/s, cm/s, mm/s.",
        ),
    ] = "",
    rate: Annotated[
        float | None,
        typer.Option(help="Rows per second: of a file that tells no time; of another, what to expect."),
    ] = None,
    finger: Annotated[int, typer.Option(min=0, help="Number of the fingertip.")] = 0,
    zeroed: Annotated[
        bool | None,
        typer.Option(
            "--zeroed/--raw",
            help="Whether counts are relative to the unloaded fingertip; else by their sign.",
        ),
    ] = None,
    slip_speed: Annotated[
        str,
        typer.Option(metavar="SPEED", help="Of the arm, above which it slips, where the file has no labels."),
    ] = "3mm/s",
    delay: Annotated[
        str, typer.Option(metavar="TIME", help="Label each touch by the arm's motion this much later.")
    ] = "0s",
    session: Annotated[
        str | None, typer.Option(metavar="NAME", help="Name of the session; by default that of the file.")
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print what is understood; write nothing.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Make a session of a CSV trace, as good as a recorded one.

    The first line names the columns. Look first with --dry-run: it prints which column is taken for what.
    """
    from connectors.files.csv_columns import ColumnMap
    from flows.graph.quantity import quantity, time
    from flows.lab.importing import Import
    from operators import Label

    understood = Import(
        trace,
        out,
        ColumnMap.parse(columns, units),
        rate=rate,
        finger=finger,
        zeroed=zeroed,
        label=Label(
            speed=quantity("import", "--slip-speed", slip_speed, "m/s"),
            delay=time("import", "--delay", delay),
        ),
        session=session,
    )
    if not dry_run:
        with progress_bar("importing") as update:
            rows = len(understood.trace.touch)
            asyncio.run(understood.write(lambda done: update(done, rows)))
    found = {**understood.summary(), "written": not dry_run}
    typer.echo(json.dumps(found) if as_json else understood.report())
    if dry_run:
        told("nothing written: a dry run")


def _sessions(dataset: Path) -> "list[Session]":
    from storage import Session
    from storage.layout import SESSION, session_folder, session_names

    names = [] if (dataset / SESSION).exists() else session_names(dataset)
    if not names:
        return [Session.open(dataset)]  # which says what is wrong if it is none
    return [Session.open(session_folder(dataset, name)) for name in names]


def _lerobot(sessions: "list[Session]", out: Path, rate: int, task: str | None) -> tuple[dict[str, Any], str]:
    from storage.exports.lerobot import export as write

    with progress_bar("exporting") as update:
        done = write(
            sessions,
            out,
            rate=rate,
            task=task,
            progress=lambda number, name: update(number, len(sessions), name),
        )
    found = asdict(done)
    splits = ", ".join(f"{split} {span}" for split, span in done.splits.items())
    cut = f"{counted(done.sessions, 'session')}, cut at {counted(done.gaps, 'gap')}"
    made = f"{counted(done.samples, 'sample')}: {counted(done.frames, 'frame')} at {rate} Hz"
    lines = [
        f"{cut}: {counted(done.episodes, 'episode')} ({splits})",
        f"{made} of {', '.join(done.features)}",
    ]
    if done.samples > done.frames:
        lines.append(
            f"{counted(done.samples - done.frames, 'sample')} became no frame: those of another fingertip, or"
            " the arm's motion, were not there; or another was nearer; or they stood alone between gaps"
        )
    lines.append(f"written: {out}")
    return found, "\n".join(lines)


def _files(sessions: "list[Session]", out: Path, to: str, detector: str | None) -> tuple[dict[str, Any], str]:
    """Write a file for each session, in the format that its ending names."""
    from storage import load_detector
    from storage.exports import mcap_file, rrd_file

    judge = None if detector is None else load_detector(detector)
    found, single = dict[str, Any](), len(sessions) == 1 and out.suffix == f".{to}"
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
                else rrd_file.export(session, path, judge, progress)
            )
            found[str(path)] = dict(written)
    rows = sum(sum(topics.values()) for topics in found.values())
    return {
        "files": found
    }, f"{counted(len(found), 'file')}, {counted(rows, 'row')}\nwritten: {', '.join(found)}"
