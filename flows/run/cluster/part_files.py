"""Reading of a session's files: all of their rows, or their times only."""

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from operators.batch import Batch, Times, column, columns
from operators.errors import InputError
from storage.files import MiB
from storage.layout import TABLE_OF, inside


@dataclass(frozen=True, slots=True, eq=False)
class RowTimes(Batch):
    """Times of rows and their positions in the files: enough to split a recording."""

    part: Times = field(metadata=column(np.int64))  # (n,) number of the file in its table
    row: Times = field(metadata=column(np.int64))  # (n,) position among the file's rows of the fingertip


def read_row_times(
    folder: Path, kind: type[Batch], path: str, sha256: str | None, part: int
) -> dict[int, RowTimes]:
    """Return the times of a file's rows by fingertip; empty if they are not of type `kind`.

    Raises:
        InputError: if the file is missing, damaged or differs from the manifest.
    """
    from storage import parts, schema  # noqa: PLC0415 - import pyarrow

    table = TABLE_OF[kind]
    rows = parts.read_part(inside(folder, folder / path), schema.time_schema(table), sha256)
    if not issubclass(_checked_type(folder / path, schema.batch_type(rows), table.kind), kind):
        return {}
    return {
        finger: RowTimes(time, np.full(len(time), part), np.arange(len(time)), finger=finger)
        for finger, time in schema.times(table, rows).items()
    }


class PartReader:
    """Reader of files with a cache, because units of many fingertips name the same files.

    Args:
        limit: Size of the cache, bytes; the newest file is always kept.
    """

    def __init__(self, limit: int = 128 * MiB) -> None:
        self._limit = limit
        self._cache: OrderedDict[tuple[str, str, str | None], Mapping[int, Batch]] = OrderedDict()
        self._size = 0  # bytes

    def read(self, folder: Path, kind: type[Batch], path: str, sha256: str | None) -> Mapping[int, Batch]:
        """Return the rows of a file by fingertip.

        Raises:
            InputError: if the file is missing, damaged or has another SHA-256.
        """
        key = str(folder), path, sha256
        if key in self._cache:
            self._cache.move_to_end(key)
            return self._cache[key]
        found = self._cache[key] = _read(folder, kind, path, sha256)
        self._size += _size(found)
        while self._size > self._limit and len(self._cache) > 1:
            _, oldest = self._cache.popitem(last=False)
            self._size -= _size(oldest)
        return found


def _read(folder: Path, kind: type[Batch], path: str, sha256: str | None) -> Mapping[int, Batch]:
    from storage import parts, schema  # noqa: PLC0415 - import pyarrow

    table = TABLE_OF[kind]
    rows = parts.read_part(inside(folder, folder / path), schema.schema(table), sha256)
    stored = _checked_type(folder / path, schema.batch_type(rows), table.kind)
    return schema.from_arrow(table, stored, rows)


def _checked_type(path: Path, stored: type[Batch] | None, kind: type[Batch]) -> type[Batch]:
    """Return the stored type of the rows, which must fit their table."""
    if stored is None or not issubclass(stored, kind):
        raise InputError(str(path), 'its metadata "batch" is missing or does not fit its table')
    return stored


def _size(rows: Mapping[int, Batch]) -> int:
    return sum(getattr(batch, name).nbytes for batch in rows.values() for name in columns(type(batch)))
