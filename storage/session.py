"""A session as a recording to read."""

import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeAlias, cast
from weakref import WeakValueDictionary

from operators.batch import Batch
from operators.errors import EndpointError, InputError, ParameterError
from operators.ports import Description, SomeBatch
from storage.description import read_session
from storage.layout import (
    JOURNAL,
    SESSION,
    SESSIONS,
    TABLE_OF,
    TABLES,
    Table,
    inside,
    may_be,
    session_folder,
    session_names,
)
from storage.lock import locked
from storage.manifest import Part, read_manifest
from storage.recovery import recover

if TYPE_CHECKING:
    import polars as pl
    import pyarrow as pa

log = logging.getLogger("slipflow")


@dataclass(frozen=True)
class _Rows:
    """The rows of one part."""

    kind: type[Batch]
    by_finger: Mapping[int, Batch]


_Held: TypeAlias = tuple[type[Batch], frozenset[int]]  # of which type rows are, of which fingertips


@dataclass(frozen=True)
class Session:
    """One session of a dataset, complete or still being recorded: what is committed is read.

    It is a `Recording`: streams come back as they were recorded, in type, order and every bit. Each file is
    checked as it is read, by its sha256 where the manifest lists it, else by the checksums of its pages; a
    file that is not listed and holds rows that are there already is not read.

    Memory holds one part of each table that is read, however long the session. Fingertips that are read side
    by side, as a replay does, share it: each part is then read once.
    """

    folder: Path
    about: Description = field(repr=False)  # session.json
    listed: Mapping[str, Part] = field(repr=False)  # the manifest, by path
    _held: dict[str, list[_Held]] = field(  # in the parts of a table, by its name; once somebody asked
        default_factory=dict[str, list[_Held]], init=False, repr=False, compare=False
    )
    _open: WeakValueDictionary[str, _Rows] = field(  # the parts that somebody reads just now, by path
        default_factory=WeakValueDictionary[str, _Rows], init=False, repr=False, compare=False
    )

    def __reduce__(self) -> tuple[type[Self], tuple[Path, Description, Mapping[str, Part]]]:
        """Pickles as what it is of; what was read stays behind."""
        return type(self), (self.folder, self.about, self.listed)

    @classmethod
    def open(cls, path: str | Path) -> Self:
        """Open a session's folder, or a dataset's that holds one session.

        One whose recorder was killed is put right first; see `storage.recover`.

        Raises:
            InputError: if there is none there or several, or what it says of itself is damaged.
        """
        folder = Path(path)
        if not may_be(folder / SESSION):
            folder = _only_session(folder)
        if may_be(folder / JOURNAL):
            _recover(folder)
        return cls(folder, read_session(folder), read_manifest(folder))

    @property
    def name(self) -> str:
        """The session's name."""
        return str(self.about["session"])

    @property
    def tables(self) -> tuple[str, ...]:
        """The tables that it holds."""
        return tuple(table.name for table in TABLES if self._paths(table))

    def files(self, kind: type[Batch]) -> dict[str, str | None]:
        """The files that hold its rows of `kind`, in order, with the sha256 that the manifest has of each."""
        table = TABLE_OF.get(kind)
        paths = self._paths(table) if table else []
        return {path: self.listed[path].sha256 if path in self.listed else None for path in paths}

    def fingers(self, kind: type[Batch]) -> tuple[int, ...]:
        """The fingertips it holds rows of `kind` for; () where it holds none.

        All of the table's files are checked for it, the first time that it is asked; of their rows, only
        whose they are is unpacked.

        Raises:
            InputError: as `read`.
        """
        table = TABLE_OF.get(kind)
        if table is None:
            return ()
        if table.name not in self._held:
            self._held[table.name] = list(self._holders(table))
        of_kind = [fingers for stored, fingers in self._held[table.name] if issubclass(stored, kind)]
        return tuple(sorted(frozenset[int]().union(*of_kind)))

    def read(self, kind: type[SomeBatch], finger: int, rows: int = 1000) -> Iterator[SomeBatch]:
        """The rows of one fingertip, as recorded, in batches of at most `rows`.

        Touch is given as Zeroed where its counts were recorded zeroed. Labelled comes from the samples, which
        do not keep all of it: its temperature is given as -1, its pose as NaN.

        Raises:
            InputError: naming the file that is missing, damaged or has the wrong columns.
            ParameterError: if `rows` is less than 1.
        """
        if rows < 1:
            raise ParameterError("Session.read", "rows", rows, "at least 1")
        for part in self._parts(kind):
            batch = part.by_finger.get(finger, kind.empty())
            for start in range(0, len(batch), rows):
                yield cast("SomeBatch", batch[start : start + rows])

    def frame(self, table: str) -> "pl.DataFrame":
        """One table, checked, which polars itself does not do.

        Raises:
            InputError: as `read`, or if it holds no such table.
        """
        import polars as pl  # noqa: PLC0415 - takes its time to import
        import pyarrow as pa  # noqa: PLC0415 - the same

        from storage import schema  # noqa: PLC0415 - it imports pyarrow

        parts: list[pa.Table] = []
        for each in TABLES:
            if each.name == table:
                parts += [self._rows(path, schema.schema(each)) for path in self._paths(each)]
        if not parts:
            reason = f"holds no table {table!r}; it holds {', '.join(self.tables) or 'none'}"
            raise InputError(str(self.folder), reason)
        return cast("pl.DataFrame", cast("Any", pl).from_arrow(pa.concat_tables(parts)))

    def describe(self) -> Description:
        """Return what session.json says."""
        return self.about

    def _parts(self, kind: type[Batch]) -> Iterator[_Rows]:
        """The parts whose rows are of `kind`."""
        from storage import schema  # noqa: PLC0415 - it imports pyarrow

        table = TABLE_OF.get(kind)
        if table is None:
            return
        before: type[Batch] | None = None
        for path in self._paths(table):
            part = self._open.get(path)
            if part is None:
                rows = self._rows(path, schema.schema(table))
                stored = self._kind(table, path, rows, before)
                part = self._open[path] = _Rows(stored, schema.from_arrow(table, stored, rows))
            before = part.kind
            if issubclass(before, kind):
                yield part

    def _holders(self, table: Table) -> Iterator[_Held]:
        """What each part of a table holds."""
        from storage import schema  # noqa: PLC0415 - it imports pyarrow

        before: type[Batch] | None = None
        for path in self._paths(table):
            rows = self._rows(path, schema.holders(table))
            before = self._kind(table, path, rows, before)
            yield before, schema.fingers(table, rows)

    def _kind(self, table: Table, path: str, rows: "pa.Table", before: type[Batch] | None) -> type[Batch]:
        """Of which type the rows of a part are, which must be that of the part `before`."""
        from storage import schema  # noqa: PLC0415 - it imports pyarrow

        stored = schema.batch_type(rows)
        if stored is None or not issubclass(stored, table.kind) or before not in {None, stored}:
            reason = 'its metadata "batch" is missing or not that of the other parts; put the right file back'
            raise InputError(str(self.folder / path), reason)
        return stored

    def _paths(self, table: Table) -> list[str]:
        """The files of a table, those that are missing included."""
        listed = {path for path in self.listed if path.startswith((f"{table.name}/", f"{table.name}."))}
        if (self.folder / JOURNAL).exists():  # what is not listed yet may come again, out of the journal
            return sorted(listed, key=_numbered)
        there = {path.relative_to(self.folder).as_posix() for path in self.folder.glob(table.pattern)}
        paths = [table.file(number) for number in range(len(there))]
        if self.listed:
            paths = sorted(there | listed, key=_numbered)
        if set(paths) <= listed:
            return paths
        from storage.unlisted import followers  # noqa: PLC0415 - it imports pyarrow

        return followers(self.folder, table, paths, self.listed)

    def _rows(self, path: str, schema: "pa.Schema") -> "pa.Table":
        from storage.parts import read_part  # noqa: PLC0415 - it imports pyarrow

        part = self.listed.get(path)
        return read_part(inside(self.folder, self.folder / path), schema, part.sha256 if part else None)


def _recover(folder: Path) -> None:
    """Put right what can be; else what is committed can still be read."""
    try:
        recover(folder)
    except EndpointError as error:
        if not locked(folder):  # else it is being recorded
            _warn(folder, str(error))


def _numbered(path: str) -> tuple[int, str]:
    """Sorts parts by their numbers, which may be of more digits."""
    return len(path), path


@cache
def _warn(folder: Path, reason: str) -> None:
    """Say it once."""
    log.warning("%s: rows that only its journal has are not read: %s", folder, reason)


def _only_session(dataset: Path) -> Path:
    if not (dataset / SESSIONS).is_dir():
        reason = f"is no session, which has a {SESSION}, and no dataset, which has a folder {SESSIONS!r}"
        raise InputError(str(dataset), reason if dataset.exists() else "there is no such folder")
    names = session_names(dataset)
    if not names:
        raise InputError(str(dataset), "holds no session: record one into it, or give another dataset")
    if len(names) > 1:
        example = dataset / SESSIONS / names[-1]
        reason = f"holds {len(names)} sessions, give one, as {example}; there are {', '.join(names)}"
        raise InputError(str(dataset), reason)
    return session_folder(dataset, names[0])
