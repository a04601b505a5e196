"""The command `slipflow fetch`."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli.terminal import progress_bar


def fetch(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Name of a recipe (default: list the recipes).")
    ] = None,
    out: Annotated[
        Path | None, typer.Argument(metavar="OUT", help="Folder of the dataset, new or empty.")
    ] = None,
) -> None:
    """Download, verify and import a public dataset of real touch.

    slipflow contains recipes, no data. A recipe states the source, the checksum of each file, licence and
    citation. Verified files stay in the cache; without a network, make the cache a clone of the source. Needs
    the extra `fetch`.

    Examples:
      slipflow fetch
      slipflow fetch strokes real
    """
    from flows.lab.recipes.grasps import GRASPS
    from flows.lab.recipes.strokes import STROKES
    from flows.report.table import counted
    from operators.checks import check_choice
    from operators.errors import ParameterError

    recipes = {each.name: each for each in (GRASPS, STROKES)}
    if name is None:
        typer.echo("\n".join(map(str, recipes.values())))
        return
    check_choice("fetch", "NAME", name, recipes)
    if out is None:
        raise ParameterError("fetch", "OUT", None, "the folder of the new dataset")
    recipe = recipes[name]
    with progress_bar("fetching") as update:
        seconds = recipe.fetch(out, update)
    typer.echo(f"{recipe}\n  source: {recipe.page}\n  {recipe.about}")
    typer.echo(f"{out}: {counted(len(seconds), 'session')}, {sum(seconds) / 60:.1f} minutes")
