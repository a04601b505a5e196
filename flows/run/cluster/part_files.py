"""The files of a session as batches: all of their rows, or just when they were taken."""

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from operators.batch import EVERY, Batch, Times, column, columns
from operators.errors import InputError
from storage.files import MiB
from storage.layout import TABLE_OF, inside


@dataclass(frozen=True, slots=True, eq=False)
class Stamps(Batch):
    """When rows were taken, and where they stand: all that is needed to cut a recording."""

    part: Times = field(metadata=column(np.int64))  # (n,) number of the file among those of its table
    row: Times = field(metadata=column(np.int64))  # (n,) among the file's rows of the fingertip


def read_stamps(
    folder: Path, kind: type[Batch], path: str, sha256: str | None, part: int
) -> dict[int, Stamps]:
    """When the rows of a file were taken, by fingertip; none if they are not of `kind`.

    Raises:
        InputError: if it is missing, damaged or not what the manifest lists.
    """
    import pyarrow as pa  # noqa: PLC0415 - takes its time to import

    from storage import parts, schema  # noqa: PLC0415 - they import it

    table = TABLE_OF[kind]
    whole: Any = schema.schema(table)
    wanted: Any = pa.schema([whole.field(name) for name in ("time", "finger")[: 1 + table.finger]])
    rows = parts.read_part(inside(folder, folder / path), wanted, sha256)
    if not issubclass(_stored(folder / path, schema.batch_type(rows), table.kind), kind):
        return {}
    time: Any = parts.flat(rows["time"]).to_numpy(zero_copy_only=False)
    fingers: Any = np.full(len(time), EVERY)
    if table.finger:
        fingers = parts.flat(rows["finger"]).to_numpy(zero_copy_only=False)
    found = dict[int, Stamps]()
    for finger in np.unique(fingers).tolist():
        own = time[fingers == finger]
        found[finger] = Stamps(own, np.full(len(own), part), np.arange(len(own)), finger=finger)
    return found


class PartReader:
    """Reads files and keeps those that were read last: the claims of many fingertips name the same ones.

    Args:
        limit: How much it keeps, bytes; the newest file in any case.
    """

    def __init__(self, limit: int = 128 * MiB) -> None:
        self._limit = limit
        self._kept: OrderedDict[tuple[str, str, str | None], Mapping[int, Batch]] = OrderedDict()
        self._size = 0  # bytes

    def read(self, folder: Path, kind: type[Batch], path: str, sha256: str | None) -> Mapping[int, Batch]:
        """The rows of a file, by fingertip.

        Raises:
            InputError: if it is missing, damaged or not the one that `sha256` tells of.
        """
        key = str(folder), path, sha256
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        found = self._kept[key] = _read(folder, kind, path, sha256)
        self._size += _size(found)
        while self._size > self._limit and len(self._kept) > 1:
            _, gone = self._kept.popitem(last=False)
            self._size -= _size(gone)
        return found


def _read(folder: Path, kind: type[Batch], path: str, sha256: str | None) -> Mapping[int, Batch]:
    from storage import parts, schema  # noqa: PLC0415 - they import pyarrow

    table = TABLE_OF[kind]
    rows = parts.read_part(inside(folder, folder / path), schema.schema(table), sha256)
    stored = _stored(folder / path, schema.batch_type(rows), table.kind)
    return schema.from_arrow(table, stored, rows)


def _stored(path: Path, stored: type[Batch] | None, kind: type[Batch]) -> type[Batch]:
    if stored is None or not issubclass(stored, kind):
        raise InputError(str(path), 'its metadata "batch" is missing or not that of its table')
    return stored


def _size(rows: Mapping[int, Batch]) -> int:
    return sum(getattr(batch, name).nbytes for batch in rows.values() for name in columns(type(batch)))
