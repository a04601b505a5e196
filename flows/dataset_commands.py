"""The commands about recordings on disk; `flows.command` registers each with one line."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.options import AsJson, progress_bar, told

if TYPE_CHECKING:
    from storage import Recovery, Verified

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415

Place = Annotated[
    Path, typer.Argument(metavar="DATASET|SESSION", help="A dataset's folder, or that of one session in it.")
]


def verify(place: Place, *, as_json: AsJson = False) -> None:
    """Read all of a dataset, or of one session, and say whether anything is missing or damaged.

    Every file is held against the manifest: sha256, checksums of its pages, rows, times. Nothing is changed,
    so it may run while something is recorded, which is checked as far as it is committed.

    Exits 0 if all is there; 3 if something was repaired, waits to be, or is known to be missing, such as rows
    that were dropped; 1 if a file that should be there is lost or damaged.
    """
    from dataclasses import asdict

    from storage import verify as check

    with progress_bar("verifying") as update:
        found = check(place, update)
    typer.echo(json.dumps({**asdict(found), "code": found.code}) if as_json else _verdict(place, found))
    if found.code:
        raise typer.Exit(found.code)


def recover(place: Place, *, as_json: AsJson = False) -> None:
    """Put right what a crash left: what the journal of a killed recording holds becomes parts of the dataset.

    Opening such a session in slipflow does the same by itself; other readers see it afterwards. Sessions that
    need nothing, or are being recorded, are left alone. What cannot be read is kept in a folder `damaged`.

    Exits 0 if there was nothing to do, 3 if something was put right, 1 if a session could not be.
    """
    from operators.errors import SlipflowError
    from storage import recover as put_right
    from storage.layout import SESSION, session_folder, session_names
    from storage.lock import locked

    single = (place / SESSION).exists()
    folders = [place] if single else [session_folder(place, name) for name in session_names(place)]
    if not folders:
        raise typer.BadParameter(f"{place} is no session and holds none")
    done: list[Recovery] = []
    errors: list[str] = []
    with progress_bar("recovering") as update:
        for number, folder in enumerate(folders, 1):
            try:
                if locked(folder):
                    told(f"{folder.name}: is being recorded just now")
                else:
                    done.append(put_right(folder))
            except SlipflowError as error:
                errors.append(str(error))
            update(number, len(folders))
    if as_json:
        sessions = [_as_dict(each) for each in done]
        typer.echo(json.dumps({"sessions": sessions, "errors": errors}))
    else:
        changed = [_report(each) for each in done if each.changed]
        typer.echo("\n".join(changed) or f"{len(done)} sessions, nothing to recover")
    for each in errors:
        typer.echo(f"error: {each}", err=True)
    if errors or any(each.changed for each in done):
        raise typer.Exit(1 if errors else 3)


def _verdict(place: Path, found: "Verified") -> str:
    lines = [f"{each.weight:5}  {each.session}: {each.text}" for each in found.findings]
    said = {0: "all is there", 3: "something was repaired or is known to be missing", 1: "something is lost"}
    size = f"{found.sessions} sessions, {found.files} files, {found.rows:,} rows"
    return "\n".join([*lines, f"{place}: {size}: {said[found.code]}"])


def _report(done: "Recovery") -> str:
    rows = ", ".join(f"{count:,} rows of {table}" for table, count in done.rows.items())
    return "\n".join(
        [f"{done.session}: back are {rows or 'no rows'}", *(f"  lost: {each}" for each in done.lost)]
    )


def _as_dict(done: "Recovery") -> dict[str, object]:
    return {
        "session": done.session,
        "rows": dict(done.rows),
        "adopted": list(done.adopted),
        "lost": list(done.lost),
        "complete": done.complete,
    }
