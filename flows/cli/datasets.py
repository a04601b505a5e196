"""The commands about recordings on disk."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.options import AsJson, counted, progress_bar, told

if TYPE_CHECKING:
    from storage import Recovery, Verified

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415

Place = Annotated[
    Path, typer.Argument(metavar="DATASET|SESSION", help="A dataset's folder, or that of one session in it.")
]


def verify(
    place: Place,
    *,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            "-o",
            metavar="FILE.html",
            help="Write a page to keep as well, into a folder that is there.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Read all of a dataset and say what is missing or damaged.

    Every file is held against the manifest: sha256, checksums of its pages, rows, times. Nothing is changed,
    so it may run while something is recorded, which is checked as far as it is committed.

    Exits 0 if all is there; 3 if something was repaired or waits to be, with nothing lost, or is known to be
    missing, such as rows that were dropped; 1 if what had been recorded is lost or damaged, also once a
    recovery has made the best of it. With --json that is "code", and "worst" is good, repairable, repaired,
    lossy or lost.
    """
    from flows.cli import verification_page as pages
    from flows.report.figures import lacking
    from storage import verify as check

    if report is not None:
        pages.claim(report)
    with progress_bar("verifying") as update:
        found = check(place, update)
    if report is not None:
        pages.write(found, place, report)
        told(f"written: {report}" + (f"; figures {reason}" if (reason := lacking()) else ""))
    typer.echo(json.dumps(pages.summary(found)) if as_json else _verdict(place, found))
    if found.code:
        raise typer.Exit(found.code)


def recover(place: Place, *, as_json: AsJson = False) -> None:
    """Put right what a crash left.

    What the journal of a killed recording holds becomes parts of the dataset. Opening such a session in
    slipflow does the same by itself; other readers see it afterwards. Sessions that need nothing, or are
    being recorded, are left alone. What cannot be read, or is there twice, is kept in a folder `damaged`.
    Parts that a manifest lists are not read: `slipflow verify` does that.

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
        raise typer.BadParameter(
            f"{place} is no session and holds none: give a dataset's folder, or that of a session in it"
        )
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


def simulate(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="The dataset's folder, new or empty.")],
    *,
    plan: Annotated[
        str, typer.Option(help="paper: 44 minutes; wide: 30, each on a material of its own; tiny: 2.")
    ] = "paper",
    seed: Annotated[int, typer.Option(help="Of everything random; the same seed gives the same bytes.")] = 0,
    delay: Annotated[
        str, typer.Option(metavar="TIME", help="Label each touch by the arm's motion this much later.")
    ] = "0s",
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes; one for each core by default.")] = None,
    as_json: AsJson = False,
) -> None:
    """Simulate a collection plan as a labelled dataset.

    Its recordings are split for training and testing.
    """
    from flows.graph.quantity import time
    from flows.lab import simulation

    with progress_bar(f"simulating {plan}") as update:
        done = simulation.simulate(
            out,
            plan,
            seed,
            delay=time("simulate", "--delay", delay),
            jobs=jobs,
            progress=update,
        )
    typer.echo(json.dumps(done.summary()) if as_json else done.report())


def _verdict(place: Path, found: "Verified") -> str:
    from flows.cli.verification_page import SAID

    wide = max((len(each.weight) for each in found.findings), default=0)
    lines = [
        f"{each.weight:{wide}}  {each.session}: {each.text}".replace(" : ", " ") for each in found.findings
    ]
    size = (
        f"{counted(found.sessions, 'session')}, {counted(found.files, 'file')}, {counted(found.rows, 'row')}"
    )
    return "\n".join([*lines, f"{place}: {size}: {SAID[found.worst]}"])


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
