"""Fetch of a recipe: pooch downloads and verifies its files, which are imported into a new dataset."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from flows.lab.importing import import_frame
from flows.lab.recipes.dataset_recipe import DatasetRecipe, Locate
from flows.lab.recipes.grasps import GRASPS
from flows.lab.recipes.strokes import STROKES
from flows.report.table import counted
from operators.errors import EndpointError, InputError
from operators.extras import require_extra
from storage.files import partial_folder

RECIPES: Final = {recipe.name: recipe for recipe in (GRASPS, STROKES)}

_ATTEMPTS: Final = 3  # after a failed download


@dataclass
class Fetched:
    """Contents of a fetched dataset."""

    recipe: DatasetRecipe
    dataset: Path
    sessions: int = 0
    seconds: float = 0.0
    groups: set[str] = field(default_factory=set[str])
    labels: Counter[str] = field(default_factory=Counter[str])

    def text(self) -> str:
        """Return the recipe and the contents as text."""
        groups = f", {counted(len(self.groups), 'group')}" if self.groups else ""
        labels = ", ".join(f"{rows:,} {name}" for name, rows in self.labels.items() if rows)
        size = f"{counted(self.sessions, 'session')}{groups}, {self.seconds / 60:.1f} minutes"
        return f"{self.recipe.text()}\n{self.dataset}: {size}; {labels}"


def fetch(
    recipe: DatasetRecipe,
    out: Path,
    source: str | None = None,
    progress: Callable[[int, int, str], object] = lambda _done, _total, _part: None,
) -> Fetched:
    """Download and verify the files of a recipe, and import them into a new dataset.

    Verified files stay in the cache of the user, ``slipflow/NAME``.

    Args:
        recipe: The recipe.
        out: Folder of the dataset, new or empty.
        source: A mirror of the files, or a folder with a copy of the source.
        progress: Called with the number of files that are there, their total, and the name of the next.

    Raises:
        InputError: if a file of the copy is missing or differs, or has an invalid value.
        EndpointError: if a file cannot be downloaded or differs, or the dataset cannot be written.
        ParameterError: if the map of a recipe does not fit its columns.
    """
    require_extra("fetch", "fetch")
    with partial_folder(out.resolve()) as dataset:
        locate = _copy(recipe, Path(source)) if source and Path(source).is_dir() else _cache(recipe, source)
        files = dict[str, Path]()
        for number, path in enumerate(recipe.registry):
            progress(number, len(recipe.registry), Path(path).name)
            files[path] = locate(path)
        found = Fetched(recipe, out)
        about = {"recipe": recipe.name, "source": recipe.page, "licence": recipe.licence}
        for recording in recipe.recordings(files.__getitem__):
            done = import_frame(
                recording.frame, dataset, recording.name, recipe.columns, group=recording.group, about=about
            ).summary()
            found.sessions += 1
            found.seconds += done["seconds"]
            found.labels.update(done["labels"])
            found.groups |= {recording.group} if recording.group else set()
    return found


def _cache(recipe: DatasetRecipe, mirror: str | None) -> Locate:
    """Return the function that downloads a file into the cache and verifies it."""
    import pooch

    pooch.get_logger().setLevel("WARNING")
    files = pooch.create(
        path=pooch.os_cache("slipflow") / recipe.name,
        base_url=f"{mirror.rstrip('/')}/" if mirror else recipe.base_url,
        registry=dict(recipe.registry),
        retry_if_failed=_ATTEMPTS,
    )

    def locate(path: str) -> Path:
        try:
            return Path(files.fetch(path))
        except (OSError, ValueError) as error:  # of requests, of the disk, of another checksum
            reason = str(error).partition("\n")[0]
            remedy = f"repeat the command, or give a copy of {recipe.page} with --from FOLDER"
            raise EndpointError(files.get_url(path), f"was not fetched: {reason:.200}; {remedy}") from error

    return locate


def _copy(recipe: DatasetRecipe, folder: Path) -> Locate:
    """Return the function that verifies a file of a copy of the source."""
    import pooch

    def locate(path: str) -> Path:
        file = folder / path
        if not file.is_file():
            raise InputError(str(file), f"does not exist: {folder} must be like a clone of {recipe.page}")
        if pooch.file_hash(str(file)) != recipe.registry[path]:
            raise InputError(str(file), f"differs from the file in {recipe.page}: its sha256 is another one")
        return file

    return locate
