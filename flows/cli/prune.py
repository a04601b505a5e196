"""The command `slipflow prune`."""

import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.options import AsJson
from flows.report.table import counted

if TYPE_CHECKING:
    from storage.retention import Pruned


def prune(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="Folder of a dataset.")],
    *,
    older_than: Annotated[
        str | None, typer.Option(metavar="TIME", help="Delete sessions older than this, such as 30d.")
    ] = None,
    larger_than: Annotated[
        str | None,
        typer.Option(
            metavar="SIZE",
            help="Delete the oldest sessions while the dataset is larger than this, such as 200GB.",
        ),
    ] = None,
    keep_unexported: Annotated[
        bool,
        typer.Option(
            "--keep-unexported", help="Keep sessions that were not exported after their last change."
        ),
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print what would be deleted; change nothing.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Delete old sessions of a dataset.

    Prints each session that a limit applies to, oldest first. Sessions that are being recorded, need a
    recovery or cannot be read are kept. `slipflow export` marks sessions as exported. The age counts from
    the end of the recording or import.

    Examples:
      slipflow prune recordings --older-than 30d --keep-unexported --dry-run
      slipflow prune recordings --larger-than 200GB
    """
    from flows.graph.quantity import parse_quantity, parse_time
    from storage.retention import prune as delete

    if older_than is None and larger_than is None:
        raise typer.BadParameter("give --older-than, --larger-than or both")
    age = None if older_than is None else parse_time("prune", "--older-than", older_than)
    limit = None if larger_than is None else round(parse_quantity("prune", "--larger-than", larger_than, "B"))
    found = delete(
        dataset,
        now=time.time_ns(),
        older_than=age,
        larger_than=limit,
        keep_unexported=keep_unexported,
        dry_run=dry_run,
    )
    if as_json:
        typer.echo(json.dumps({"dry_run": dry_run, "sessions": [asdict(each) for each in found]}))
        return
    for each in found:
        typer.echo(_line(each, "would delete" if dry_run else "deleted"))
    deleted = [each.size for each in found if not each.kept]
    verb = "would be freed" if dry_run else "freed"
    typer.echo(f"{counted(len(deleted), 'session')}, {sum(deleted) / 1e6:,.1f} MB {verb}")


def _line(pruned: "Pruned", done: str) -> str:
    from operators.batch import s

    extent = f"{pruned.size / 1e6:,.1f} MB, {pruned.age / s / 86400:.1f} days"
    if pruned.kept:
        return f"kept {pruned.session} ({extent}): {pruned.kept}"
    return f"{done} {pruned.session} ({extent}) because of {pruned.reason}"
