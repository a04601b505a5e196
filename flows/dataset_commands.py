"""The commands about recordings on disk; `flows.command` registers each with one line."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.options import AsJson, counted, progress_bar, told

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

    Exits 0 if all is there; 3 if something was repaired or waits to be, with nothing lost, or is known to be
    missing, such as rows that were dropped; 1 if what had been recorded is lost or damaged, also once a
    recovery has made the best of it.
    """
    from dataclasses import asdict

    from storage import verify as check

    with progress_bar("verifying") as update:
        found = check(place, update)
    typer.echo(
        json.dumps({**asdict(found), "worst": found.worst, "code": found.code})
        if as_json
        else _verdict(place, found)
    )
    if found.code:
        raise typer.Exit(found.code)


def recover(place: Place, *, as_json: AsJson = False) -> None:
    """Put right what a crash left: what the journal of a killed recording holds becomes parts of the dataset.

    Opening such a session in slipflow does the same by itself; other readers see it afterwards. Sessions that
    need nothing, or are being recorded, are left alone. What cannot be read, or is there twice, is kept in a
    folder `damaged`. Parts that a manifest lists are not read: `slipflow verify` does that.

    Exits 0 if there was nothing to do, 3 if something was put right, 1 if a session could not be.
    """
    from operators.errors import SlipflowError
    from storage import recover as put_right
    from storage.layout import SESSION, SESSIONS, headless, headless_names, session_folder, session_names
    from storage.lock import locked

    single = (place / SESSION).exists() or headless(place)
    folders = [place] if single else [session_folder(place, name) for name in session_names(place)]
    beheaded = [place / SESSIONS / name for name in ([] if single else headless_names(place))]
    if not folders and not beheaded:
        raise typer.BadParameter(f"{place} is no session and holds none")
    done: list[Recovery] = []
    errors = [f"{folder}: its {SESSION} is gone: see slipflow verify" for folder in beheaded]
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
        nothing = f"{counted(len(done), 'session')}, nothing to recover; slipflow verify reads every file"
        typer.echo("\n".join(changed) or nothing)
    for each in errors:
        typer.echo(f"error: {each}", err=True)
    if errors or any(each.changed for each in done):
        raise typer.Exit(1 if errors else 3)


def _verdict(place: Path, found: "Verified") -> str:
    wide = max((len(each.weight) for each in found.findings), default=0)
    lines = [
        f"{each.weight:{wide}}  {each.session}: {each.text}".replace(" : ", " ") for each in found.findings
    ]
    said = {
        "note": "all is there",
        "repairable": "something waits to be repaired, nothing is lost",
        "repaired": "something was repaired, nothing is lost",
        "lossy": "something is known to be missing",
        "lost": "something is lost",
    }
    size = (
        f"{counted(found.sessions, 'session')}, {counted(found.files, 'file')}, {counted(found.rows, 'row')}"
    )
    return "\n".join([*lines, f"{place}: {size}: {said[found.worst]}"])


def _report(done: "Recovery") -> str:
    rows = ", ".join(f"{count:,} rows of {table}" for table, count in done.rows.items())
    lines = [f"{'cut off' if each in done.cut else 'lost'}: {each}" for each in done.lost]
    return "\n  ".join([f"{done.session}: back are {rows or 'no rows'}", *lines, *done.done])


def _as_dict(done: "Recovery") -> dict[str, object]:
    return {
        "session": done.session,
        "rows": dict(done.rows),
        "adopted": list(done.adopted),
        "lost": list(done.lost),
        "cut": list(done.cut),
        "done": list(done.done),
        "complete": done.complete,
    }
