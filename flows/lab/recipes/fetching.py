"""Fetch of a recipe: download or local files, verification, import as a dataset."""

import os
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import rmtree
from typing import Any, TypeAlias

from connectors.files.column_map import TIME
from flows.lab.importing import TraceImport
from flows.lab.recipes.dataset_recipe import DatasetRecipe
from flows.lab.recipes.download import Download, is_verified, location
from flows.lab.recipes.fetched import DATASET, FILES, RECORD, is_fetched, recipe_folder
from flows.lab.recipes.recipe_text import recipe_json, recipe_text, size_text
from flows.lab.recipes.source_table import source_table
from flows.report.table import counted
from operators.errors import EndpointError, InputError, os_error_reason
from storage.files import PARTIAL, make_folder, partial_folder, put_json, read_json
from storage.lock import lock

Progress: TypeAlias = Callable[[int, int, str], None]  # done, of how many kB or recordings, part


@dataclass(frozen=True)
class Fetched:
    """Result of a fetch.

    Args:
        recipe: The recipe.
        dataset: Folder of the dataset.
        files: Folder of the source files.
        loaded: Number of files that were downloaded now.
        imported: The dataset was written now; False: it was there.
        contents: Sessions, groups, seconds and labels of the dataset, and notes on the import.
    """

    recipe: DatasetRecipe
    dataset: Path
    files: Path
    loaded: int
    imported: bool
    contents: dict[str, Any]

    def json(self) -> dict[str, Any]:
        """Return the result as JSON data."""
        return {
            **recipe_json(self.recipe),
            "dataset": str(self.dataset),
            "files": str(self.files),
            "downloaded": self.loaded,
            "imported": self.imported,
            "contents": self.contents,
        }

    def text(self) -> str:
        """Return the result as text."""
        recipe, found = self.recipe, self.contents
        lines = [recipe_text(recipe)]
        if self.imported:
            verified = f"{counted(len(recipe.files), 'file')}, {size_text(recipe.bytes)}, all checksums match"
            lines.append(f"{self.files}: {verified}; {self.loaded} downloaded now")
        groups = f", {counted(len(found['groups']), recipe.group)}" if recipe.split == "group" else ""
        labels = ", ".join(f"{rows:,} {name}" for name, rows in found["labels"].items() if rows)
        size = f"{counted(found['sessions'], 'session')}{groups}, {found['seconds'] / 60:.1f} minutes"
        state = "" if self.imported else "fetched before; "
        lines.append(f"{self.dataset}: {state}{size}; {labels if recipe.labelled else 'no labels'}")
        return "\n".join([*lines, *(f"note: {each}" for each in found["notes"])])


async def fetch(
    recipe: DatasetRecipe,
    folder: Path | None = None,
    *,
    files: Path | None = None,
    mirror: str | None = None,
    progress: Progress = lambda _done, _total, _part: None,
) -> Fetched:
    """Download, verify and import the files of a recipe; what is there and verified is kept.

    Args:
        recipe: The recipe.
        folder: Folder of all recipes; default: `cache_folder`.
        files: Folder with a copy of the source's files, instead of a download.
        mirror: Folder of the files on another server.
        progress: Called with the kB or recordings that are done, all of them, and the part in progress.

    Raises:
        InputError: if the recipe has no files, a file in `files` is missing or differs, or has an invalid
            value.
        EndpointError: if a file cannot be downloaded, or a folder cannot be written.
        ParameterError: if the mirror is not https, or http on this machine.
    """
    if not recipe.files:
        raise InputError(
            f"recipe {recipe.name}",
            f"only documents a dataset, without checksums: download it from {recipe.page}, then use `slipflow"
            " import`, or write a recipe with checksums",
        )
    where = recipe_folder(recipe, folder)
    with _locked(where):
        if is_fetched(recipe, where):
            contents = read_json(where / RECORD)["dataset"]
            return Fetched(recipe, where / DATASET, where / FILES, 0, imported=False, contents=contents)
        if files:
            check_files(recipe, files)
        source, loaded = files or where / FILES, 0
        if not files:

            def kilobytes(done: int, total: int, part: str) -> None:
                progress(done // 1000, total // 1000, part)

            loaded = len(await Download(recipe, source, mirror).run(kilobytes))
        (where / RECORD).unlink(missing_ok=True)
        for old in (where / DATASET, where / f"{DATASET}{PARTIAL}"):  # of another version, or of a killed run
            rmtree(old, ignore_errors=True)
        with partial_folder(where / DATASET) as dataset:
            contents = await _import(recipe, source, dataset, progress)
        put_json(where / RECORD, {"recipe": recipe.digest, **recipe_json(recipe), "dataset": contents})
    return Fetched(recipe, where / DATASET, source, loaded, imported=True, contents=contents)


def check_files(recipe: DatasetRecipe, folder: Path) -> None:
    """Verify the files of a recipe in a folder.

    Raises:
        InputError: naming the first file that is missing or differs, and how many do.
        EndpointError: if one cannot be read, or a link leads out of the folder.
    """
    wrong = [file for file in recipe.files if not is_verified(file, location(file, folder))]
    if wrong:
        first, path = wrong[0], folder / wrong[0].path
        problem = "differs from the source (another size or checksum)" if path.exists() else "does not exist"
        others = f", as do {len(wrong) - 1} others" if len(wrong) > 1 else ""
        raise InputError(
            str(path),
            f"{problem}{others}: get {recipe.link(first)}; {folder} must be like a clone of {recipe.page}",
        )


async def _import(recipe: DatasetRecipe, files: Path, dataset: Path, progress: Progress) -> dict[str, Any]:
    """Import all recordings into a new dataset and return its contents."""
    columns = replace(recipe.column_map, units={**recipe.units, TIME: "ns"}, resolution=recipe.resolution)
    seconds, notes, labels = 0.0, list[str](), dict[str, int]()
    for number, recording in enumerate(recipe.recordings):
        progress(number, len(recipe.recordings), recording.name)
        table = source_table(recipe, recording, files)
        trace = TraceImport(
            table,
            dataset,
            columns,
            rate=recipe.rate,
            zeroed=recipe.zeroed,
            session=recording.name,
            group=recording.group or None,
            pad=recipe.pad,
        )
        await trace.write()
        found = trace.summary()
        seconds += found["seconds"]
        notes += [f"{recording.name}: {each}" for each in (*table.notes, *found["warnings"])]
        labels = {name: labels.get(name, 0) + rows for name, rows in found["labels"].items()}
    return {
        "sessions": len(recipe.recordings),
        "groups": sorted({each.group for each in recipe.recordings}),
        "seconds": round(seconds, 3),
        "labels": labels,
        "notes": notes,
    }


@contextmanager
def _locked(folder: Path) -> Generator[None]:
    """Make a folder and lock it."""
    try:
        make_folder(folder, parents=True)
        descriptor = lock(folder)
    except OSError as error:
        raise EndpointError(str(folder), f"cannot be written: {os_error_reason(error)}") from error
    if descriptor is None:
        raise EndpointError(str(folder), "is in use by another `slipflow fetch`: wait until it has finished")
    try:
        yield
    finally:
        os.close(descriptor)
