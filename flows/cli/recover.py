"""The command `slipflow recover`."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from flows.cli.options import AsJson, DatasetOrSession
from flows.cli.terminal import note, progress_bar
from flows.report.table import counted

if TYPE_CHECKING:
    from storage import Recovery


def recover(path: DatasetOrSession, *, as_json: AsJson = False) -> None:
    """Repair recordings after a crash.

    Moves rows from the journal of a killed recording into the dataset. Opening such a session with slipflow
    does the same; other readers see the rows only afterwards. Sessions that are complete, or are being
    recorded, are not changed. Unreadable and duplicate files are moved to the folder `damaged`. Files in the
    manifest are not read; `slipflow verify` reads them.

    Exits 0 if there was nothing to do, 3 if something was repaired, 1 if a session could not be repaired.

    Examples:
      slipflow recover recordings
    """
    from operators.errors import InputError, SlipflowError
    from storage.layout import SESSION, SESSIONS, lacks_description, names_without_description, session_names

    if not path.is_dir():
        reason = "is a file, must be a folder" if path.exists() else "there is no such folder"
        raise InputError(str(path), reason)
    single = (path / SESSION).exists() or lacks_description(path)
    folders = [path] if single else [path / SESSIONS / name for name in session_names(path)]
    without_description = [
        path / SESSIONS / name for name in ([] if single else names_without_description(path))
    ]
    if not folders and not without_description:
        raise typer.BadParameter(f"{path} is neither a session nor a dataset with sessions")
    done: list[Recovery] = []
    errors = [f"{folder}: {SESSION} is missing: see slipflow verify" for folder in without_description]
    with progress_bar("recovering") as update:
        for number, folder in enumerate(folders, 1):
            try:
                done += _repaired(path, folder)
            except SlipflowError as error:
                errors.append(str(error))
            update(number, len(folders))
    if as_json:
        sessions = [{**vars(each), "rows": dict(each.rows), "complete": each.complete} for each in done]
        typer.echo(json.dumps({"sessions": sessions, "errors": errors}))
    else:
        lines = [_text(each) for each in done if each.changed]
        if not lines and not errors:
            lines = [f"{counted(len(done), 'session')}, nothing to recover; slipflow verify reads every file"]
        for line in lines:
            typer.echo(line)
    for each in errors:
        typer.echo(f"error: {each}", err=True)
    if errors or any(each.changed for each in done):
        raise typer.Exit(1 if errors else 3)


def _repaired(root: Path, folder: Path) -> "list[Recovery]":
    """Recover a session unless it is being recorded."""
    from storage import recover as repair
    from storage.layout import inside
    from storage.lock import locked

    if locked(inside(root, folder)):
        note(f"{folder.name}: skipped, it is being recorded")
        return []
    return [repair(folder)]


def _text(done: "Recovery") -> str:
    rows = ", ".join(f"{count:,} rows of {table}" for table, count in done.rows.items())
    lines = [f"{'cut off' if each in done.cut else 'lost'}: {each}" for each in done.lost]
    return "\n  ".join([f"{done.session}: recovered {rows or 'no rows'}", *lines, *done.done])
