"""Session of a dataset as a recording to read."""

import logging
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self, cast

from operators.batch import Batch, Touch
from operators.checks import check_at_least
from operators.errors import EndpointError, InputError
from operators.fingertip import Fingertip, measured
from operators.ports import Description, SomeBatch
from storage import schema
from storage.arrow import pa
from storage.description import read_session
from storage.files import locked
from storage.hand_labels import HandLabels, LabelSpan, read_hand_labels, write_hand_labels
from storage.journal import journal_files
from storage.layout import SESSION, TABLE_OF, TABLES, Table, check_links, session_folders, table_of
from storage.parts import Part, read_manifest, read_part
from storage.recovery import recover

if TYPE_CHECKING:
    import polars as pl

PARTS_IN_MEMORY: Final = 8  # of all sessions: one of each table

log = logging.getLogger("slipflow")


@lru_cache(maxsize=PARTS_IN_MEMORY)
def _read_part(folder: Path, part: Part) -> dict[int, Batch]:
    """Read and verify a part by fingertip; fingertips that are read in parallel share it."""
    rows, table = read_part(folder, part), cast("Table", table_of(part.path))
    stored = schema.batch_type(rows)
    if stored is None or not issubclass(stored, table.kind):
        reason = 'its metadata "batch" is no type of its table; restore a copy'
        raise InputError(str(folder / part.path), reason)
    return schema.from_arrow(table, stored, rows)


@dataclass(frozen=True)
class Session:
    """Session of a dataset, complete or still being recorded, as a `Recording`: it reads the committed rows.

    Rows are read as they were recorded, with the same type, order and bits. Only files in the manifest are
    read; each is verified by its sha256.

    The last parts that were read are in memory, however long the session.

    Attributes:
        folder: Folder of the session.
        about: Content of session.json.
        listed: Parts in the manifest, by path.
    """

    folder: Path
    about: Description = field(repr=False)
    listed: Mapping[str, Part] = field(repr=False)
    _fingers: dict[type[Batch], tuple[int, ...]] = field(  # by type of the rows, once read
        default_factory=dict[type[Batch], tuple[int, ...]], init=False, repr=False, compare=False
    )

    @classmethod
    def open(cls, path: str | Path) -> Self:
        """Open a session by its folder, or by that of a dataset with one; `recover` it if it was killed.

        Raises:
            InputError: if there is no session or several, it contains a link, or its description or manifest
                is damaged.
        """
        folder = _only_session(Path(path))
        check_links(folder)
        if journal_files(folder):
            _recover(folder)
        about = read_session(folder)
        return cls(folder, about, read_manifest(folder, about))

    @property
    def name(self) -> str:
        """Name of its folder, which is safe as a file name, unlike the one in session.json."""
        return self.folder.name

    @property
    def tables(self) -> tuple[str, ...]:
        """Tables that it has."""
        return tuple(table.name for table in TABLES if self._listed(table))

    def fingertip(self, kind: type[Batch]) -> Fingertip | None:
        """Return the fingertip of the rows of `kind`; measured, if session.json does not state it.

        None if there are no rows of `kind`, or their type has no cells.

        Raises:
            InputError: as `read`, or if session.json has an invalid entry.
        """
        table, stated = TABLE_OF.get(kind), self.about.get("fingertips", {})
        if table is None or not issubclass(table.kind, Touch):
            return None
        if isinstance(stated, dict) and (content := stated.get(table.name)):
            return Fingertip.read(content, str(self.folder / SESSION))
        if not (fingers := self.fingers(kind)):
            return None
        return measured(next(self.read(cast("type[Touch]", kind), fingers[0])))

    def fingers(self, kind: type[Batch]) -> tuple[int, ...]:
        """Return the fingertips that have rows of `kind`.

        The first call for a table verifies all its files.
        """
        if kind not in self._fingers:
            self._fingers[kind] = tuple(sorted(set[int]().union(*self._parts(kind))))
        return self._fingers[kind]

    def read(self, kind: type[SomeBatch], finger: int, rows: int = 1000) -> Iterator[SomeBatch]:
        """Yield the rows of one fingertip, as recorded, in batches of at most `rows`.

        Touch is read as Zeroed if its counts were recorded zeroed. Labelled is read from the samples, which
        do not store all columns: the temperature is -1, the pose NaN.

        Raises:
            InputError: if a file is missing, damaged or has the wrong columns.
            ParameterError: if `rows` is below 1.
        """
        check_at_least("Session.read", "rows", rows, 1)
        for part in self._parts(kind):
            batch = part.get(finger, kind.empty())
            for start in range(0, len(batch), rows):
                yield batch[start : start + rows]

    def frame(self, table: str) -> "pl.DataFrame":
        """Return one table as a polars DataFrame, after verifying its files.

        Raises:
            InputError: as `read`, or if there is no such table.
        """
        import polars as pl

        kinds = [each for each in TABLES if each.name == table]
        parts = [read_part(self.folder, part) for each in kinds for part in self._listed(each)]
        if not parts:
            reason = f"has no table {table!r}; it has {', '.join(self.tables) or 'none'}"
            raise InputError(str(self.folder), reason)
        return cast("pl.DataFrame", cast("Any", pl).from_arrow(pa.concat_tables(parts)))

    def hand_labels(self) -> HandLabels:
        """Return the newest labels that were given by hand, as `read_hand_labels`."""
        return read_hand_labels(self.folder, self.about)

    def write_hand_labels(self, spans: Iterable[LabelSpan], *, based_on: int) -> HandLabels:
        """Write all spans as the next version of the hand labels, as `write_hand_labels`."""
        return write_hand_labels(self.folder, self.about, spans, based_on=based_on)

    def describe(self) -> Description:
        """Return the content of session.json."""
        return self.about

    def _parts(self, kind: type[SomeBatch]) -> Iterator[dict[int, SomeBatch]]:
        """Yield the rows of `kind` of each part, by fingertip."""
        table = TABLE_OF.get(kind)
        for listed in self._listed(table) if table else ():
            part = _read_part(self.folder, listed)
            yield {finger: batch for finger, batch in part.items() if isinstance(batch, kind)}

    def _listed(self, table: Table) -> list[Part]:
        """Return the parts of a table in order."""
        return [part for path, part in self.listed.items() if table.has(path)]


def _recover(folder: Path) -> None:
    """Recover a session; if that fails, its committed rows can still be read."""
    try:
        recover(folder)
    except EndpointError as error:
        if not locked(folder):  # it is not being recorded
            _warn(folder, str(error))


@cache
def _warn(folder: Path, reason: str) -> None:
    """Log a warning once per session."""
    log.warning("%s: the rows in its journal are not read: %s", folder, reason)


def _only_session(dataset: Path) -> Path:
    folders = session_folders(dataset)
    if len(folders) == 1:
        return folders[0]
    if not folders:
        raise InputError(str(dataset), "has no session: record one, or give another dataset")
    names = ", ".join(each.name for each in folders)
    reason = f"has {len(folders)} sessions: give one, such as {folders[-1]}; it has {names}"
    raise InputError(str(dataset), reason)
