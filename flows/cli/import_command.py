"""The command `slipflow import`."""

import asyncio
import json
from pathlib import Path
from typing import Annotated

import typer

from flows.cli.options import AsJson, Delay
from flows.cli.terminal import note, progress_bar


def import_(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help="Recordings of a fingertip: .csv, .parquet, .npz, .mcap, or folders of ROS 2 bags.",
        ),
    ],
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="Dataset to add the sessions to, or a new folder.")
    ],
    *,
    columns: Annotated[
        str,
        typer.Option(
            "--map",
            metavar="NAME=COLUMNS,...",
            help="Columns of the file: time=t,counts=p0..p5,speed=v,label=slip. Names: time, counts (one"
            " column per cell; e* means all that match, by number), velocity (3 or 6), speed, joint (with"
            " --lever), label. Names left out are recognised by usual column names; label= means no labels."
            " List columns without numbers: counts=left,right,top,bottom,tip,base.",
        ),
    ] = "",
    units: Annotated[
        str,
        typer.Option(
            metavar="NAME=UNIT,...",
            help="Units, such as time=ms,counts=kPa,speed=mm/s. Time: s, ms, us, ns; counts: count, Pa, hPa,"
            " mbar, kPa, N, V and others (Pa:kPa converts); velocity and speed: m/s, cm/s, mm/s; joint:"
            " rad/s, deg/s (default: the unit in the column name, else s, count, m/s, rad/s).",
        ),
    ] = "",
    labels: Annotated[
        str,
        typer.Option(
            metavar="LABEL=VALUES,...",
            help="Values of the label column: slip=1,2,static=0,unknown=9; with slip= alone, all others are"
            " static (default: 1, 0, -1, true, false, slip, static, unknown).",
        ),
    ] = "",
    lever: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH",
            help="Distance from the joint's axis to the fingertip, such as 96mm: speed = |joint| x lever.",
        ),
    ] = None,
    resolution: Annotated[
        float | None,
        typer.Option(
            help="Units per stored count (default: keeps all digits, or is as fine as 16 bits allow)."
        ),
    ] = None,
    layout: Annotated[
        str,
        typer.Option(
            metavar="LAYOUT",
            help="Positions of the cells: ROWSxCOLUMNS, numbered from the top left, such as 8x2; or the cell"
            " numbers of each row from the top, such as 5,4,3/0,1,2; -1: no cell (default: as on a TakkTile"
            " for six cells, else about square).",
        ),
    ] = "",
    range_: Annotated[
        str,
        typer.Option(
            "--range",
            metavar="LOW:HIGH",
            help="Readings at the lowest and at the highest pressure, in the unit of the file; 1023:0 states"
            " that readings fall as the pressure rises (default: unknown).",
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
            help="Readings are relative to the unloaded fingertip or raw (default: zeroed if any is"
            " negative).",
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
        str | None,
        typer.Option(metavar="NAME", help="Name of the session of a single file (default: the file's name)."),
    ] = None,
    group: Annotated[
        str,
        typer.Option(
            metavar="PATTERN",
            help="Surface or object: first group of this regular expression in the file's name, such as"
            " '(.+)_vel'. Benchmarks split by it.",
        ),
    ] = "",
    topic: Annotated[
        str,
        typer.Option(metavar="NAME", help="Topic of an MCAP file or ROS 2 bag (default: its only topic)."),
    ] = "",
    motion_topic: Annotated[
        str, typer.Option(metavar="NAME", help="Topic with the motion (default: that of the fingertip).")
    ] = "",
    separator: Annotated[
        str,
        typer.Option(
            metavar="SIGN",
            help="Separator of CSV files: a character, comma, semicolon, tab, space or pipe (default:"
            " detected).",
        ),
    ] = "",
    header: Annotated[
        str,
        typer.Option(metavar="NAMES", help="Column names of CSV files without such a line: t,p0..p5."),
    ] = "",
    lenient: Annotated[
        bool,
        typer.Option(
            "--lenient",
            help="Treat cells and speeds that are not numbers as missing; leave out rows without a time.",
        ),
    ] = False,
    skip_existing: Annotated[
        bool, typer.Option("--skip-existing", help="Leave out files that the dataset has already.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print how the files are interpreted; write nothing.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Import recordings of any fingertip as sessions of a dataset.

    The first line of a CSV file has the column names. All files are read and checked before anything is
    written. Use --dry-run first to check how the columns are interpreted.

    Examples:
      slipflow import trace.csv recordings --dry-run
      slipflow import trace.csv lab --map time=t,counts=p0..p5,speed=v --units time=ms,speed=mm/s
      slipflow import *.parquet strokes --map counts=e*,joint=w --lever 96mm --group '(.+)_vel'
    """
    from connectors.files.column_map import ColumnMap, expanded
    from connectors.files.formats import read_table
    from connectors.files.pad import Pad
    from flows.graph.quantity import parse_quantity, parse_time
    from flows.lab.file_imports import FileImports
    from flows.lab.importing import TraceImport
    from operators import Label

    column_map = ColumnMap.parse(
        columns,
        units,
        labels,
        lever=None if lever is None else parse_quantity("import", "--lever", lever, "m"),
        resolution=resolution,
        lenient=lenient,
    )
    label = Label(
        speed=parse_quantity("import", "--slip-speed", slip_speed, "m/s"),
        delay=parse_time("import", "--delay", delay),
    )
    pad = Pad.parse(layout, range_)
    names = [name for item in header.split(",") if item for name in expanded(item.strip())]

    def make(path: Path, column_map: ColumnMap, session: str, group: str | None) -> TraceImport:
        table = read_table(path, separator=separator, header=names, topic=topic, motion_topic=motion_topic)
        return TraceImport(
            table,
            out,
            column_map,
            rate=rate,
            finger=finger,
            zeroed=zeroed,
            label=label,
            session=session,
            group=group,
            pad=pad,
        )

    with progress_bar("reading") as update:
        imports = FileImports(
            files,
            out,
            column_map,
            make,
            group=group,
            session=session,
            skip_existing=skip_existing,
            progress=update,
        )
    if dry_run or imports.failed:
        written = 0
    else:
        with progress_bar("importing") as update:
            written = asyncio.run(imports.write(update))
    found = {**imports.summary(), "written": written}
    typer.echo(json.dumps(found) if as_json else imports.report())
    if imports.failed:
        note(f"error: {imports.failed} of {len(files)} files cannot be imported, so nothing was written")
        raise typer.Exit(2)
    if dry_run:
        note("dry run: nothing written")
