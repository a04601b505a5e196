"""The command `slipflow import`."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from flows.cli.terminal import note, progress_bar


def import_(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="Recordings of a fingertip: .csv, .csv.gz or .parquet."),
    ],
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="Dataset to add the sessions to, or a new folder.")
    ],
    *,
    columns: Annotated[
        str,
        typer.Option(
            "--map",
            metavar="MAP",
            help="Columns of the files, or @FILE: time=t,counts=p0..p5,speed=v,units.time=ms. Quantities left"
            " out are recognised by usual names.",
        ),
    ] = "",
    group: Annotated[
        str,
        typer.Option(
            metavar="PATTERN",
            help="Surface or object: first group of this regular expression in the file's name, such as"
            " '(.+)_vel'. Evaluations split by it.",
        ),
    ] = "",
    split: Annotated[
        bool, typer.Option("--split", help="Make a session of each part where the clock starts again.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print how the files are interpreted; write nothing.")
    ] = False,
) -> None:
    """Import CSV or Parquet files of any fingertip as sessions.

    Use --dry-run first to check how the columns are interpreted. Files that the dataset has already are left
    out. For other formats, pass a DataFrame to flows.lab.importing.import_frame in Python.

    Examples:
      slipflow import trace.csv recordings --dry-run
      slipflow import trace.csv lab --map time=t,counts=p0..p5,speed=v,units.time=ms,units.speed=mm/s
      slipflow import *.parquet strokes --map @pad.map --group '(.+)_vel'
    """
    from connectors.files.column_map import ColumnMap
    from flows.lab.importing import import_files
    from flows.report.table import counted
    from operators.errors import SlipflowError
    from storage.toml_text import read_text

    stated = ColumnMap.parse(read_text(Path(columns[1:])) if columns.startswith("@") else columns)
    failed, last, columns_before = 0, out, list[str]()
    with progress_bar("importing") as update:
        update(0, len(files), files[0].name)
        done = import_files(files, out, stated, group=group, split=split, dry_run=dry_run)
        for number, (path, found) in enumerate(done, 1):
            update(min(number, len(files)), len(files))
            if isinstance(found, SlipflowError):
                failed += 1
                typer.echo(f"error: {found}" if str(path) in str(found) else f"error: {path}: {found}")
                continue
            last, left_out = out / "sessions" / found.session, found.state == "present"
            if dry_run or not left_out:
                typer.echo(found.report(short=found.interpretation() == columns_before))
                columns_before = found.interpretation()
            if left_out:
                typer.echo(f"{found.session}: left out, the dataset has it; to replace it, delete {last}")
    if failed:
        note(f"error: {failed} of {counted(len(files), 'file')} cannot be imported: repair and repeat")
        raise typer.Exit(2)
    if dry_run:
        note("dry run: nothing written; next: the same command without --dry-run")
    else:
        note(f"next: slipflow show {shlex.quote(str(last))}")
