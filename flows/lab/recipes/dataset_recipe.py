"""Recipe of a public dataset: its source, licence and files, and the function that reads its recordings."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from connectors.files.column_map import ColumnMap

if TYPE_CHECKING:
    import polars as pl

Locate: TypeAlias = Callable[[str], Path]  # verified file of a path of the registry


@dataclass(frozen=True, slots=True)
class SourceRecording:
    """Recording of a public dataset.

    Args:
        name: Name of its session.
        frame: Its rows.
        group: Surface or object, by which recordings are split.
    """

    name: str
    frame: "pl.DataFrame"
    group: str | None = None


@dataclass(frozen=True)
class DatasetRecipe:
    """Public dataset. The recipe contains no data.

    Args:
        name: Name of the recipe.
        title: Sensor, task and rate in one line.
        size: Number and size of the recordings.
        repository: GitHub repository, OWNER/NAME.
        commit: Commit of the files, 40 hex digits.
        licence: SPDX identifier, or ``none`` if the source states no licence.
        terms: Consequence of the licence for users.
        citation: Work to cite.
        about: Description of the recordings.
        assumed: Assumptions that the source does not confirm.
        labels: Origin of the labels.
        columns: Map of the columns of the recordings.
        registry: sha256 of each file, hex, by its path in the repository.
        recordings: Reads the files and yields the recordings.
    """

    name: str
    title: str
    size: str
    repository: str
    commit: str
    licence: str
    terms: str
    citation: str
    about: str
    assumed: str
    labels: str
    columns: ColumnMap
    registry: Mapping[str, str]
    recordings: Callable[[Locate], Iterator[SourceRecording]]

    @property
    def base_url(self) -> str:
        """Address of the folder of the files."""
        return f"https://raw.githubusercontent.com/{self.repository}/{self.commit}/"

    @property
    def page(self) -> str:
        """Address of the source for a browser."""
        return f"https://github.com/{self.repository}/tree/{self.commit}"

    def summary(self) -> str:
        """Return title, size, licence and citation."""
        return f"{self.name}: {self.title}\n  {self.size}; licence: {self.licence}\n  cite: {self.citation}"

    def text(self) -> str:
        """Return all that the recipe states about the dataset."""
        parts = {"source": self.page, "terms": self.terms, "about": self.about, "assumed": self.assumed}
        lines = [f"{name}: {text}" for name, text in {**parts, "labels": self.labels}.items()]
        return "\n  ".join([self.summary(), *lines])


def read_registry(path: Path) -> dict[str, str]:
    """Return the sha256 of each file, by its path, from the lines ``PATH SHA256`` of a registry of pooch."""
    lines = path.read_text("utf-8").splitlines()
    return {name: sha256 for name, sha256 in (line.rsplit(maxsplit=1) for line in lines)}  # noqa: C416 - pairs
