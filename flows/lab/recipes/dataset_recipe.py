"""Recipe of a public dataset: its source, licence and files, and the function that reads its recordings.

pooch downloads and verifies the files, which are imported into a new dataset.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeAlias

from connectors.files.column_map import ColumnMap
from flows.lab.importing import import_frame
from operators.errors import EndpointError
from operators.extras import require_extra
from storage.files import partial_output

if TYPE_CHECKING:
    import polars as pl

_ATTEMPTS: Final = 3  # after a failed download

# name of the session, rows, and the surface or object by which recordings are split
SourceRecording: TypeAlias = "tuple[str, pl.DataFrame, str | None]"


@dataclass(frozen=True)
class DatasetRecipe:
    """Public dataset. The recipe contains no data.

    Args:
        name: Name of the recipe.
        summary: Sensor, task, rate, size and work to cite.
        licence: SPDX identifier, or ``none`` if the source states no licence.
        about: Consequence of the licence, description of the recordings, origin of the labels, and
            assumptions that the source does not confirm.
        repository: GitHub repository, OWNER/NAME.
        commit: Commit of the files, 40 hex digits.
        columns: Map of the columns of the recordings.
        registry: File with the path in the repository and the sha256 of each file, as pooch reads it.
        recordings: Yields the recordings, given the verified copy of each file by its path in the repository.
    """

    name: str
    summary: str
    licence: str
    about: str
    repository: str
    commit: str
    columns: ColumnMap
    registry: Path
    recordings: Callable[[Mapping[str, Path]], Iterator[SourceRecording]]

    def __str__(self) -> str:
        return f"{self.name}: {self.summary}\n  licence: {self.licence}"

    @property
    def base_url(self) -> str:
        """Address of the folder of the files."""
        return f"https://raw.githubusercontent.com/{self.repository}/{self.commit}/"

    @property
    def page(self) -> str:
        """Address of the source for a browser."""
        return f"https://github.com/{self.repository}/tree/{self.commit}"

    def fetch(self, out: Path, progress: Callable[[int, int, str], object] = lambda *_: None) -> list[float]:
        """Download and verify the files, and import them into a new dataset.

        Verified files stay in the user's cache, ``slipflow/NAME``, which may also be a clone of the source.

        Args:
            out: Folder of the dataset, new or empty.
            progress: Called with the number of files that are there, their total, and the name of the next.

        Returns:
            Duration of each session, s.

        Raises:
            InputError: if a file has an invalid value.
            EndpointError: if a file cannot be downloaded or differs, or the dataset cannot be written.
            ParameterError: if the map of a recipe does not fit its columns.
        """
        require_extra("fetch", "fetch")
        about = {"recipe": self.name, "source": self.page, "licence": self.licence}
        seconds = list[float]()
        with partial_output(out.resolve()) as dataset:
            for name, frame, group in self.recordings(self._files(progress)):
                done = import_frame(frame, dataset, name, self.columns, group=group, about=about)
                seconds.append(done.trace.part.seconds)
        return seconds

    def _files(self, progress: Callable[[int, int, str], object]) -> dict[str, Path]:
        """Download the files that the cache lacks; return the verified copy of each."""
        import pooch

        pooch.get_logger().setLevel("WARNING")
        cache = pooch.create(pooch.os_cache("slipflow") / self.name, self.base_url, retry_if_failed=_ATTEMPTS)
        cache.load_registry(self.registry)
        files = dict[str, Path]()
        for number, path in enumerate(cache.registry):
            progress(number, len(cache.registry), Path(path).name)
            try:
                files[path] = Path(cache.fetch(path))
            except (OSError, ValueError) as error:  # of requests, of the disk, of another checksum
                reason = str(error).partition("\n")[0]
                remedy = f"repeat the command, or copy a clone of {self.page} to {cache.path}"
                raise EndpointError(
                    cache.get_url(path), f"was not fetched: {reason:.200}; {remedy}"
                ) from error
        return files
