"""The command `slipflow fetch`."""

import asyncio
import json
from pathlib import Path
from typing import Annotated

import typer

from flows.cli.options import AsJson
from flows.cli.terminal import note, progress_bar


def fetch(
    recipe: Annotated[
        str | None,
        typer.Argument(
            metavar="RECIPE",
            help="Name of a recipe, or a recipe file such as mine.toml (default: list the recipes).",
        ),
    ] = None,
    *,
    to: Annotated[
        Path | None,
        typer.Option(
            "--to",
            metavar="DIR",
            help="Folder of all recipes (default: $XDG_CACHE_HOME/slipflow, else ~/.cache/slipflow).",
        ),
    ] = None,
    files: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Copy of the source, such as a git clone: verify and import it, download nothing.",
        ),
    ] = None,
    mirror: Annotated[
        str | None,
        typer.Option(
            "--from", metavar="URL", help="Download from a copy of the source on another server (https)."
        ),
    ] = None,
    show: Annotated[
        bool, typer.Option("--print", help="Print the recipe file, as a template to edit; download nothing.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Download, verify and import a public dataset of real touch.

    A recipe names the source, the commit, the checksum of every file, the columns, the labels, the licence
    and the citation. slipflow contains recipes, no data. Every file is verified; a file with another
    checksum is never imported. An interrupted download continues where it ended. DIR/RECIPE/files has the
    files of the source, DIR/RECIPE/dataset the dataset. Without a network, put the files into the first
    folder, or use --files.

    Examples:
      slipflow fetch
      slipflow fetch strokes
      slipflow fetch grasps --to data --files ~/clones/proactive-slip-control
      slipflow fetch strokes --print > mine.toml
    """
    from flows.lab.recipes.dataset_recipe import load_recipe, recipe_file, shipped_recipes
    from flows.lab.recipes.fetched import recipe_folder
    from flows.lab.recipes.fetching import fetch as fetch_recipe
    from flows.lab.recipes.recipe_text import recipe_json, recipe_summary, recipe_text, size_text

    if recipe is None:
        found = [*shipped_recipes()]
        listed = [recipe_json(each) for each in found]
        typer.echo(json.dumps(listed) if as_json else "\n".join(map(recipe_summary, found)))
        return
    if show:
        typer.echo(recipe_file(recipe)[1], nl=False)
        return
    described = load_recipe(recipe)
    if not (described.files or as_json):
        typer.echo(recipe_text(described))
    elif described.files:
        note(f"{described.name}: {size_text(described.bytes)} into {recipe_folder(described, to)}")
    with progress_bar("fetching") as update:
        done = asyncio.run(fetch_recipe(described, to, files=files, mirror=mirror, progress=update))
    typer.echo(json.dumps(done.json()) if as_json else done.text())
