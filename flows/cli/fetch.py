"""The command `slipflow fetch`."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli.terminal import progress_bar


def fetch(
    recipe: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Name of a recipe (default: list the recipes).")
    ] = None,
    out: Annotated[
        Path | None, typer.Argument(metavar="OUT", help="Folder of the dataset, new or empty.")
    ] = None,
    *,
    source: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="FOLDER|URL",
            help="Copy of the source, such as a git clone or a mirror (default: the source on GitHub).",
        ),
    ] = None,
) -> None:
    """Download, verify and import a public dataset of real touch.

    slipflow contains recipes, no data. A recipe states the source and its commit, the checksum of each file,
    licence and citation. A file with another checksum is never imported. Verified files stay in the cache.

    Examples:
      slipflow fetch
      slipflow fetch strokes real
      slipflow fetch grasps real --from ~/clones/proactive-slip-control
    """
    from flows.lab.recipes.fetching import RECIPES
    from flows.lab.recipes.fetching import fetch as fetch_recipe
    from operators.checks import check_choice
    from operators.errors import ParameterError

    if recipe is None:
        typer.echo("\n".join(each.summary() for each in RECIPES.values()))
        return
    check_choice("fetch", "NAME", recipe, RECIPES)
    if out is None:
        raise ParameterError("fetch", "OUT", None, "the folder of the new dataset")
    with progress_bar("fetching") as update:
        done = fetch_recipe(RECIPES[recipe], out, source, update)
    typer.echo(done.text())
