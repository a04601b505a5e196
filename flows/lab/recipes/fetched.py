"""Folders of fetched recipes."""

import os
from pathlib import Path
from typing import Final

from flows.lab.recipes.dataset_recipe import SHIPPED, DatasetRecipe
from operators.errors import InputError
from storage.files import read_json

FILES: Final = "files"  # folder of the source files
DATASET: Final = "dataset"  # folder of the imported dataset
RECORD: Final = "fetched.json"  # written last


def cache_folder() -> Path:
    """Return the default folder of fetched recipes: below XDG_CACHE_HOME, else ``~/.cache``.

    Source: XDG Base Directory Specification 0.8, which ignores a relative XDG_CACHE_HOME.
    """
    cache = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return (cache if cache.is_absolute() else Path.home() / ".cache") / "slipflow"


def recipe_folder(recipe: DatasetRecipe, folder: Path | None = None) -> Path:
    """Return the folder of a recipe: its source files and its dataset.

    Args:
        recipe: The recipe.
        folder: Folder of all recipes; default: `cache_folder`.
    """
    return (folder or cache_folder()) / recipe.name


def fetched_dataset(recipe: DatasetRecipe, folder: Path | None = None) -> Path:
    """Return the dataset of a fetched recipe.

    Args:
        recipe: The recipe.
        folder: Folder of all recipes; default: `cache_folder`.

    Raises:
        InputError: if it was not fetched, or with another version of the recipe; it names the command.
    """
    where = recipe_folder(recipe, folder)
    if not is_fetched(recipe, where):
        command = f"slipflow fetch {recipe.name}{f' --to {folder}' if folder else ''}"
        other = (where / RECORD).is_file() and (where / DATASET).is_dir()
        state = "was fetched by another version of the recipe" if other else "was not fetched"
        raise InputError(str(where), f"recipe {recipe.name} {state}: run `{command}` first")
    return where / DATASET


def own_dataset(name: str, folder: Path | None = None) -> Path | None:
    """Return the dataset of a recipe file that was fetched, by the recipe's name; None if there is none.

    Args:
        name: Name of the recipe; shipped recipes are none.
        folder: Folder of all recipes; default: `cache_folder`.
    """
    where = (folder or cache_folder()) / name
    known = name not in SHIPPED and Path(name).name == name and (where / RECORD).is_file()
    return where / DATASET if known and (where / DATASET).is_dir() else None


def labelled_own_datasets(folder: Path | None = None) -> dict[str, Path]:
    """Return the labelled datasets of recipe files that were fetched, by name; `folder` as above.

    Raises:
        InputError: if the record of a fetch is damaged.
    """
    where = folder or cache_folder()
    names = sorted(each.name for each in where.iterdir()) if where.is_dir() else []
    found = {name: own_dataset(name, where) for name in names}
    return {
        name: path
        for name, path in found.items()
        if path is not None and read_json(where / name / RECORD).get("labelled")
    }


def is_fetched(recipe: DatasetRecipe, folder: Path) -> bool:
    """Return True if the folder of a recipe has its complete dataset, by this version of the recipe.

    Raises:
        InputError: if the record of the fetch is damaged.
    """
    record = folder / RECORD
    return (
        record.is_file() and read_json(record).get("recipe") == recipe.digest and (folder / DATASET).is_dir()
    )
