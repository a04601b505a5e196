"""The command `slipflow import`."""

import json
import shlex
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from flows.cli.options import AsJson
from flows.cli.terminal import note, progress_bar

if TYPE_CHECKING:
    from connectors.files.column_map import ColumnMap


_FLOW: Final = Template('''"""Detect slip live in a file that grows, such as $source."""

from pathlib import Path

from connectors import Console, LineSource
from flows.graph import Flow
from operators import Debounce, Score, Zero
from storage import Dataset, load_debounce, load_detector

HERE = Path(__file__).parent


def $name(source: str = "$source", model: str = "$name.safetensors", out: str = "live") -> Flow:
    """Print slip events of a file that grows, or of a serial port, and record the touch.

    Args:
        source: The file, or a device such as /dev/ttyACM0.
        model: Detector, as `slipflow train` writes it.
        out: Dataset to record into.
    """
    flow = Flow("$name")
    touch = flow.source(LineSource(source, HERE / "$name.toml"))
    slips = touch | Zero() | Score(load_detector(model)) | (load_debounce(model) or Debounce())
    slips.to(Console())
    touch.to(Dataset(out))
    return flow
''')


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
            help="Columns of the files, as text or as a TOML file with the same keys:"
            " time=t,counts=p0..p5,speed=v,units.time=ms. Quantities left out are recognised by usual names.",
        ),
    ] = "",
    session: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Name of the session of a single file (default: the file's name)."),
    ] = None,
    group: Annotated[
        str,
        typer.Option(
            metavar="PATTERN",
            help="Surface or object: first group of this regular expression in the file's name, such as"
            " '(.+)_vel'. Evaluations split by it.",
        ),
    ] = "",
    labelled: Annotated[
        str | None,
        typer.Option("--label", metavar="LABEL", help="Label of all rows: slip, static or unknown."),
    ] = None,
    split: Annotated[
        bool, typer.Option("--split", help="Make a session of each part where the clock starts again.")
    ] = False,
    flow: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.py",
            help="Write a flow that follows such a file live, and FILE.toml, the map with all conclusions.",
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print how the files are interpreted; write nothing.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Import CSV or Parquet files of any fingertip as sessions.

    Use --dry-run first to check how the columns are interpreted. Files that the dataset has already are left
    out. Read other formats in Python and pass a DataFrame to flows.lab.importing.import_frame.

    Examples:
      slipflow import trace.csv recordings --dry-run
      slipflow import trace.csv lab --map time=t,counts=p0..p5,speed=v,units.time=ms,units.speed=mm/s
      slipflow import *.parquet strokes --map pad.toml --group '(.+)_vel'
      slipflow import bench.csv own --flow own.py
    """
    from dataclasses import replace

    from connectors.files.column_map import ColumnMap
    from flows.lab.importing import import_files
    from flows.report.table import counted
    from operators.errors import InputError

    stated = ColumnMap.load(columns)
    stated = replace(stated, labelled=labelled) if labelled else stated
    listed, before, found_map = list[dict[str, Any]](), list[str](), stated
    with progress_bar("importing") as update:
        update(0, len(files), files[0].name)
        done = import_files(files, out, stated, group=group, session=session, split=split, dry_run=dry_run)
        for path, found in done:
            if isinstance(found, InputError):
                listed.append({"file": str(path), "state": "failed", "error": str(found)})
                text = f"error: {found}"
            else:
                listed.append({"file": str(path), "state": found.state, "error": "", **found.summary()})
                text = found.report(short=found.interpretation() == before)
                found_map = found_map if before else found.trace.part.columns
                before = found.interpretation()
            update(len(listed), len(files))
            if not as_json:
                typer.echo(text)
    if as_json:
        typer.echo(json.dumps({"dataset": str(out), "files": listed}))
    states = [each["state"] for each in listed]
    if present := states.count("present"):
        note(f"{counted(present, 'session')} left out: the dataset has them already")
    if failed := states.count("failed"):
        note(f"error: {failed} of {counted(len(files), 'file')} cannot be imported: repair and repeat")
        raise typer.Exit(2)
    if dry_run:
        mapped = ["--map", columns] if columns else []
        again = ["slipflow", "import", *map(str, files), str(out), *mapped, "--flow", f"{out.name}.py"]
        note(f"dry run: nothing written; next: {shlex.join(again)}")
        return
    if flow and not flow.exists():
        note(f"{flow} follows such a file live, by the map {_write_flow(flow, files[0], found_map)}")
    if states[0] == "written":
        note(f"next: slipflow show {shlex.quote(str(out / 'sessions' / listed[0]['session']))}")


def _write_flow(path: Path, source: Path, columns: "ColumnMap") -> Path:
    """Write a flow file that follows `source` by default and, next to it, the map; return its path."""
    from operators.errors import ParameterError
    from storage.files import write_errors

    if path.suffix != ".py" or not path.stem.isidentifier():
        raise ParameterError("import", "--flow", str(path), "a new Python file such as own.py")
    toml = path.with_suffix(".toml")
    with write_errors(path):
        for file, text in ((path, _FLOW.substitute(name=path.stem, source=source)), (toml, columns.toml())):
            with file.open("x", encoding="utf-8") as opened:
                opened.write(text)
    return toml
