"""Output of the commands that derive a model from another one."""

import json
from typing import TYPE_CHECKING

import typer

from flows.cli.terminal import note

if TYPE_CHECKING:
    from flows.learn.adaptation.derived_model import Derived


def print_derived(derived: "Derived", *, as_json: bool) -> None:
    """Print the result; exit 3 if the new model was not written because it is not better."""
    typer.echo(json.dumps(derived.summary()) if as_json else derived.report())
    if derived.model is None:
        note("nothing was written; --keep-new writes the new model anyway")
        raise typer.Exit(3)
