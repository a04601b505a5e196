"""Session of a dataset as a recording to read."""

import logging
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeAlias, cast
from weakref import WeakValueDictionary

from operators.batch import Batch, Touch
from operators.checks import check_at_least
from operators.errors import EndpointError, InputError
from operators.fingertip import Fingertip, measured
from operators.ports import Description, SomeBatch
from storage import schema
from storage.arrow import pa
from storage.description import read_session
from storage.hand_labels import HandLabels, LabelSpan, read_hand_labels, write_hand_labels
from storage.layout import (
    JOURNAL,
    SESSION,
    SESSIONS,
    TABLE_OF,
    TABLES,
    Table,
    check_links,
    inside,
    may_exist,
    part_number,
    session_folder,
    session_names,
)
from storage.lock import locked
from storage.parts import Part, read_manifest, read_part
from storage.recovery import recover

if TYPE_CHECKING:
    import polars as pl

log = logging.getLogger("slipflow")


@dataclass(frozen=True)
class _Part:
    """Rows of one part."""

    kind: type[Batch]
    by_finger: Mapping[int, Batch]


_PartFingers: TypeAlias = tuple[type[Batch], frozenset[int]]  # type and fingertips of the rows of a part


@dataclass(frozen=True)
class Session:
    """Session of a dataset, complete or still being recorded, as a `Recording`: it reads the committed rows.

    Rows are read as they were recorded, with the same type, order and bits. Only files in the manifest are
    read; each is verified by its sha256.

    One part of each table is in memory, however long the session. Fingertips that are read in parallel, as
    in a replay, share it.

    Attributes:
        folder: Folder of the session.
        about: Content of session.json.
        listed: Parts in the manifest, by path.
    """

    folder: Path
    about: Description = field(repr=False)
    listed: Mapping[str, Part] = field(repr=False)
    _fingers: dict[str, list[_PartFingers]] = field(  # of the parts of a table, by its name, once read
        default_factory=dict[str, list[_PartFingers]], init=False, repr=False, compare=False
    )
    _open: WeakValueDictionary[str, _Part] = field(  # parts being read, by path
        default_factory=WeakValueDictionary[str, _Part], init=False, repr=False, compare=False
    )
    _only: dict[str, _Part] = field(  # part of a table with one part, by its name, until it is read
        default_factory=dict[str, _Part], init=False, repr=False, compare=False
    )

    def __reduce__(self) -> tuple[type[Self], tuple[Path, Description, Mapping[str, Part]]]:
        """Pickle the session without the rows in memory."""
        return type(self), (self.folder, self.about, self.listed)

    @classmethod
    def open(cls, path: str | Path) -> Self:
        """Open a session by its folder, or by the folder of a dataset with one session.

        A session whose recorder was killed is recovered first; see `storage.recover`.

        Raises:
            InputError: if there is no session or several, it contains a link, or its description or manifest
                is damaged.
        """
        folder = Path(path)
        if not may_exist(folder / SESSION):
            folder = _only_session(folder)
        check_links(folder)
        if may_exist(folder / JOURNAL):
            _recover(folder)
        return cls(folder, read_session(folder), read_manifest(folder))

    @property
    def name(self) -> str:
        """Name of the session."""
        return str(self.about["session"])

    @property
    def tables(self) -> tuple[str, ...]:
        """Tables that it has."""
        return tuple(table.name for table in TABLES if self._paths(table))

    def files(self, kind: type[Batch]) -> dict[str, str]:
        """Return the files with its rows of `kind`, in order, with their sha256."""
        table = TABLE_OF.get(kind)
        return {path: self.listed[path].sha256 for path in (self._paths(table) if table else [])}

    def fingertip(self, kind: type[Batch]) -> Fingertip | None:
        """Return the fingertip of the rows of `kind`; measured, if session.json does not state it.

        Returns:
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
        kept = self._only.copy()
        first = next(self.read(cast("type[Touch]", kind), fingers[0]))
        self._only.update(kept)  # `read` drops it, but the rest of its rows will be read
        return measured(first)

    def fingers(self, kind: type[Batch]) -> tuple[int, ...]:
        """Return the fingertips that have rows of `kind`.

        The first call for a table verifies all its files.

        Raises:
            InputError: as `read`.
        """
        table = TABLE_OF.get(kind)
        if table is None:
            return ()
        if table.name not in self._fingers:
            self._fingers[table.name] = list(self._part_fingers(table))
        of_kind = [fingers for stored, fingers in self._fingers[table.name] if issubclass(stored, kind)]
        return tuple(sorted(frozenset[int]().union(*of_kind)))

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
            batch = part.by_finger.get(finger, kind.empty())
            for start in range(0, len(batch), rows):
                yield cast("SomeBatch", batch[start : start + rows])

    def frame(self, table: str) -> "pl.DataFrame":
        """Return one table as a polars DataFrame, after verifying its files.

        Raises:
            InputError: as `read`, or if there is no such table.
        """
        import polars as pl  # noqa: PLC0415 - slow to import

        parts: list[pa.Table] = []
        for each in TABLES:
            if each.name == table:
                parts += [self._rows(path, schema.schema(each)) for path in self._paths(each)]
        if not parts:
            reason = f"has no table {table!r}; it has {', '.join(self.tables) or 'none'}"
            raise InputError(str(self.folder), reason)
        return cast("pl.DataFrame", cast("Any", pl).from_arrow(pa.concat_tables(parts)))

    def hand_labels(self, version: int | None = None) -> HandLabels:
        """Return the newest labels that were given by hand, or those of a version, as `read_hand_labels`.

        Raises:
            SlipflowError: as `read_hand_labels`.
        """
        return read_hand_labels(self.folder, version)

    def write_hand_labels(self, spans: Iterable[LabelSpan], *, based_on: int) -> HandLabels:
        """Write all spans as the next version of the hand labels, as `write_hand_labels`.

        Raises:
            SlipflowError: as `write_hand_labels`.
        """
        return write_hand_labels(self.folder, spans, based_on=based_on)

    def describe(self) -> Description:
        """Return the content of session.json."""
        return self.about

    def _parts(self, kind: type[Batch]) -> Iterator[_Part]:
        """Yield the parts with rows of `kind`."""
        table = TABLE_OF.get(kind)
        if table is None:
            return
        _only, before = self._only.pop(table.name, None), None  # keeps the part until it is read
        for path in self._paths(table):
            part = self._part(table, path, before)
            before = part.kind
            if issubclass(before, kind):
                yield part

    def _part(self, table: Table, path: str, before: type[Batch] | None = None) -> _Part:
        """Return a part in memory, or read it."""
        part = self._open.get(path)
        if part is None:
            rows = self._rows(path, schema.schema(table))
            stored = self._kind(table, path, rows, before)
            part = self._open[path] = _Part(stored, schema.from_arrow(table, stored, rows))
        return part

    def _part_fingers(self, table: Table) -> Iterator[_PartFingers]:
        """Yield type and fingertips of each part of a table."""
        before: type[Batch] | None = None
        paths = self._paths(table)
        if len(paths) == 1:  # a short session: read the file once
            part = self._only[table.name] = self._part(table, paths[0])
            yield part.kind, frozenset(part.by_finger)
            return
        for path in paths:
            rows = self._rows(path, schema.finger_schema(table))
            before = self._kind(table, path, rows, before)
            yield before, schema.fingers(table, rows)

    def _kind(self, table: Table, path: str, rows: "pa.Table", before: type[Batch] | None) -> type[Batch]:
        """Return the type of the rows of a part, which must be that of the part `before`."""
        stored = schema.batch_type(rows)
        if stored is None or not issubclass(stored, table.kind) or before not in {None, stored}:
            reason = 'its metadata "batch" is missing or differs from the other parts; restore a copy'
            raise InputError(str(self.folder / path), reason)
        return stored

    def _paths(self, table: Table) -> list[str]:
        """Return the files of a table in order."""
        return sorted(filter(table.has, self.listed), key=part_number)

    def _rows(self, path: str, expected: "pa.Schema") -> "pa.Table":
        return read_part(inside(self.folder, self.folder / path), expected, self.listed[path].sha256)


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
    if not (dataset / SESSIONS).is_dir():
        reason = f"is not a session (no {SESSION}) and not a dataset (no folder {SESSIONS!r})"
        raise InputError(str(dataset), reason if dataset.exists() else "there is no such folder")
    names = session_names(dataset)
    if not names:
        raise InputError(str(dataset), "has no session: record one, or give another dataset")
    if len(names) > 1:
        example = dataset / SESSIONS / names[-1]
        reason = f"has {len(names)} sessions: give one, such as {example}; it has {', '.join(names)}"
        raise InputError(str(dataset), reason)
    return session_folder(dataset, names[0])
