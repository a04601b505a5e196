"""The Parquet files of a LeRobot dataset."""

import json
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from storage.exports.lerobot_files import CHUNK, DATA, DataFiles, statistics, write_tasks

FEATURES: Any = {"x": {"dtype": "float32", "shape": [2]}, "index": {"dtype": "int64", "shape": [1]}}


def values(rows: int, index: int) -> dict[str, Any]:
    return {"x": np.full((rows, 2), index, np.float32), "index": np.arange(rows) + index}


def test_a_full_file_is_followed_by_the_next_and_an_episode_is_in_one(tmp_path: Path) -> None:
    with DataFiles(tmp_path, FEATURES, max_bytes=200) as data:
        places = [data.write(values(rows, 100 * k)) for k, rows in enumerate((5, 5, 5, 30, 1))]
        data.close()
        found = data.statistics()
    assert places == [(0, 0), (0, 0), (0, 1), (0, 2), (0, 3)]
    tables = [
        cast("Any", pq).read_table(tmp_path / DATA.format(chunk_index=0, file_index=k)) for k in range(4)
    ]
    assert [len(table) for table in tables] == [10, 5, 30, 1]
    index = np.concatenate([table["index"].to_numpy() for table in tables])
    assert found["index"] == statistics(index)
    assert found["x"]["max"] == [400, 400]


def test_an_episode_is_one_row_group(tmp_path: Path) -> None:
    with DataFiles(tmp_path, FEATURES) as data:
        for k, rows in enumerate((3, 1, 7)):
            data.write(values(rows, k))
    file: Any = pq.ParquetFile(tmp_path / DATA.format(chunk_index=0, file_index=0))
    assert [file.metadata.row_group(k).num_rows for k in range(file.num_row_groups)] == [3, 1, 7]


def test_a_folder_has_a_limited_number_of_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert CHUNK == 1000
    monkeypatch.setattr("storage.exports.lerobot_files.CHUNK", 2)
    with DataFiles(tmp_path, FEATURES, max_bytes=1) as data:
        assert [data.write(values(1, k)) for k in range(5)] == [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0)]
    assert (tmp_path / DATA.format(chunk_index=2, file_index=0)).exists()


@given(
    arrays.arrays(
        np.float32, st.tuples(st.integers(1, 20), st.integers(1, 4)), elements=st.floats(-9, 9, width=32)
    )
)
def test_statistics_are_ordered(data: NDArray[np.float32]) -> None:
    found = statistics(data)
    order = ("min", "q01", "q10", "q50", "q90", "q99", "max")
    for one, other in pairwise(order):
        assert (np.array(found[one]) <= np.array(found[other])).all()
    assert found["mean"] == pytest.approx(data.astype(np.float64).mean(axis=0).tolist())
    assert found["count"] == [len(data)]
    assert all(len(found[name]) == data.shape[1] for name in (*order, "mean", "std"))


def test_the_text_of_tasks_is_the_index_in_pandas(tmp_path: Path) -> None:
    write_tasks(tmp_path, ["slide", "hold"])
    table = cast("Any", pq).read_table(tmp_path / "meta/tasks.parquet")
    assert table.to_pydict() == {"task_index": [0, 1], "task": ["slide", "hold"]}
    assert json.loads(table.schema.metadata[b"pandas"])["index_columns"] == ["task"]
