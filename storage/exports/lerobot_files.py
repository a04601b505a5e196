"""Parquet files of a LeRobot dataset, and their statistics."""

from __future__ import annotations  # they name classes of pyarrow

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Self, cast

import numpy as np
from numpy.typing import NDArray

from storage.arrow import pa, pq
from storage.schema import flat

DATA: Final = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
TASKS: Final = "meta/tasks.parquet"
EPISODES: Final = "meta/episodes/chunk-000/file-000.parquet"
CHUNK: Final = 1000  # files per folder
MAX_MB: Final = 100  # size of a data file, uncompressed

_QUANTILES: Final = (0.01, 0.1, 0.5, 0.9, 0.99)

Statistics = dict[str, list[float]]


class DataFiles:
    """Writer of the files with the frames: one row group per episode; a full file is followed by the next."""

    def __init__(self, root: Path, features: Mapping[str, Mapping[str, Any]], max_bytes: int = 0) -> None:
        """Write below `root`; a file is full at `max_bytes` (default 100 MB)."""
        self.rows = 0  # written
        self._root, self._features = root, features
        self._types = {name: _arrow(each) for name, each in features.items()}
        self._schema = pa.schema(self._types)
        self._max_bytes = max_bytes or MAX_MB << 20
        self._writer: Any = None
        self._number = -1  # of the open file
        self._bytes = 0  # in the open file

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, values: Mapping[str, NDArray[Any]]) -> tuple[int, int]:
        """Write one episode; return the numbers of its chunk and file."""
        arrays = [_array(values[name], kind) for name, kind in self._types.items()]
        table = pa.Table.from_arrays(arrays, schema=self._schema)
        if self._writer is None or self._bytes + table.nbytes > self._max_bytes:
            self.close()
            self._number, self._bytes = self._number + 1, 0
            path = self._path(self._number)
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = cast("Any", pq).ParquetWriter(path, self._schema, compression="snappy")
        self._writer.write_table(table, row_group_size=max(len(table), 1))
        self._bytes += table.nbytes
        self.rows += len(table)
        return divmod(self._number, CHUNK)

    def close(self) -> None:
        """Complete the open file."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def statistics(self) -> dict[str, Statistics]:
        """Return the statistics of each feature over all episodes; one feature at a time is in memory."""
        paths = [self._path(number) for number in range(self._number + 1)]
        found: dict[str, Statistics] = {}
        for name, feature in self._features.items():
            columns: list[Any] = [cast("Any", pq).read_table(path, columns=[name])[name] for path in paths]
            values = [flat(each).to_numpy(zero_copy_only=False) for each in columns]
            found[name] = statistics(np.concatenate(values).reshape(-1, *feature["shape"]))
        return found

    def _path(self, number: int) -> Path:
        chunk, file = divmod(number, CHUNK)
        return self._root / DATA.format(chunk_index=chunk, file_index=file)


def statistics(values: NDArray[Any]) -> Statistics:
    """Return minimum, maximum, mean, standard deviation, quantiles and count of values (n, ...).

    >>> found = statistics(np.array([1, 2, 6]))
    >>> found["mean"], found["q50"], found["count"]
    ([3.0], [2.0], [3])
    """
    rows = np.asarray(values, np.float64).reshape(len(values), -1)  # (n, elements)
    found: Statistics = {
        "min": rows.min(axis=0).tolist(),
        "max": rows.max(axis=0).tolist(),
        "mean": rows.mean(axis=0).tolist(),
        "std": rows.std(axis=0).tolist(),
        "count": [len(rows)],
    }
    for share, quantile in zip(_QUANTILES, np.quantile(rows, _QUANTILES, axis=0), strict=True):
        found[f"q{round(100 * share):02d}"] = quantile.tolist()
    return found


def write_tasks(root: Path, tasks: Sequence[str]) -> None:
    """Write the tasks by number; the metadata makes the text the index in pandas, as LeRobot expects."""
    columns = [("task_index", "int64", "int64"), ("task", "unicode", "object")]
    pandas = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [
            {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
            for name, kind, numpy in columns
        ],
        "pandas_version": "2.0.0",
    }
    types: dict[str, pa.DataType] = {"task_index": pa.int64(), "task": pa.string()}
    schema = pa.schema(types, {"pandas": json.dumps(pandas)})
    numbers = list(range(len(tasks)))
    _write(root / TASKS, pa.Table.from_pydict({"task_index": numbers, "task": list(tasks)}, schema))


def write_episodes(root: Path, episodes: Sequence[Mapping[str, Any]]) -> None:
    """Write the table of episodes, one row each."""
    _write(root / EPISODES, pa.Table.from_pylist([dict(episode) for episode in episodes]))


def _write(path: Path, table: pa.Table) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cast("Any", pq).write_table(table, path, compression="snappy")


def _arrow(feature: Mapping[str, Any]) -> pa.DataType:
    element: pa.DataType = pa.from_numpy_dtype(np.dtype(feature["dtype"]))
    (size,) = feature["shape"]
    if size > 1:
        element = cast("Any", pa).list_(element, size)
    return element


def _array(values: NDArray[Any], kind: pa.DataType) -> pa.Array[Any]:
    flattened: pa.Array[Any] = pa.array(values.reshape(-1))
    if pa.types.is_fixed_size_list(kind):
        flattened = cast("Any", pa.FixedSizeListArray).from_arrays(flattened, values.shape[1])
    return flattened
