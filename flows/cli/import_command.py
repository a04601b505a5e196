"""The command `slipflow import`."""

import asyncio
import json
from pathlib import Path
from typing import Annotated

import typer

from flows.cli.options import AsJson, Delay
from flows.cli.terminal import note, progress_bar


def import_(
    trace: Annotated[Path, typer.Argument(metavar="TRACE.csv", help="Trace of one fingertip.")],
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="Dataset to add the session to, or a new folder.")
    ],
    *,
    columns: Annotated[
        str,
        typer.Option(
            "--map",
            metavar="NAME=COLUMNS,...",
            help="Columns of the file: time=t,counts=p0..p5,speed=v,label=slip. Names: time, counts (one"
            " column per cell), velocity (3 or 6), speed, label. Names left out are recognised by usual"
            " column names; label= means no labels. List columns without numbers:"
            " counts=left,right,top,bottom,tip,base.",
        ),
    ] = "",
    units: Annotated[
        str,
        typer.Option(
            metavar="NAME=UNIT,...",
            help="Units, such as time=ms,speed=mm/s. Time: s, ms, us, ns; velocity and speed: m/s, cm/s, mm/s"
            " (default: the unit in the column name, else s and m/s).",
        ),
    ] = "",
    rate: Annotated[
        float | None,
        typer.Option(help="Rows per second: required for a file without time, else the rate to expect."),
    ] = None,
    finger: Annotated[int, typer.Option(min=0, help="Number of the fingertip.")] = 0,
    zeroed: Annotated[
        bool | None,
        typer.Option(
            "--zeroed/--raw",
            help="Counts are relative to the unloaded fingertip or raw (default: zeroed if any is negative).",
        ),
    ] = None,
    slip_speed: Annotated[
        str,
        typer.Option(
            metavar="SPEED",
            help="Label samples as slip above this arm speed (if the file has no labels).",
        ),
    ] = "3mm/s",
    delay: Delay = "0s",
    session: Annotated[
        str | None, typer.Option(metavar="NAME", help="Name of the session (default: the file's name).")
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print how the file is interpreted; write nothing.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Import a CSV trace as a session of a dataset.

    The first line has the column names. Use --dry-run first to check how the columns are interpreted.

    Examples:
      slipflow import trace.csv recordings --dry-run
      slipflow import trace.csv lab --map time=t,counts=p0..p5,speed=v --units time=ms,speed=mm/s
    """
    from connectors.files.column_map import ColumnMap
    from flows.graph.quantity import parse_quantity, parse_time
    from flows.lab.importing import TraceImport
    from operators import Label

    trace_import = TraceImport(
        trace,
        out,
        ColumnMap.parse(columns, units),
        rate=rate,
        finger=finger,
        zeroed=zeroed,
        label=Label(
            speed=parse_quantity("import", "--slip-speed", slip_speed, "m/s"),
            delay=parse_time("import", "--delay", delay),
        ),
        session=session,
    )
    if not dry_run:
        with progress_bar("importing") as update:
            rows = len(trace_import.trace.touch)
            asyncio.run(trace_import.write(lambda done: update(done, rows)))
    found = {**trace_import.summary(), "written": not dry_run}
    typer.echo(json.dumps(found) if as_json else trace_import.report())
    if dry_run:
        note("dry run: nothing written")
