"""Import of many files."""

import asyncio
import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from connectors.files.column_map import ColumnMap
from flows.lab.file_imports import FileImports
from flows.lab.importing import TraceImport
from operators.batch import Touch
from operators.errors import EndpointError, InputError
from storage import Session

KPA = ColumnMap(units={"counts": "kPa"})


def put(path: Path, *, step: float = 0.01, rate: float = 100, cells: int = 2, low: float = 90) -> Path:
    rows = np.arange(300)
    values = {f"p{cell}": low + step * (rows % 50 + cell) for cell in range(cells)}
    pl.DataFrame({"t": rows / rate, **values}).write_parquet(path)
    return path


def make(out: Path, path: Path, columns: ColumnMap, session: str, group: str | None) -> TraceImport:
    return TraceImport(path, out, columns, session=session, group=group)


def imports(paths: list[Path], out: Path, columns: ColumnMap = KPA, **settings: Any) -> FileImports:  # noqa: ANN401
    return FileImports(paths, out, columns, partial(make, out), **settings)


def test_all_files_get_the_same_resolution(tmp_path: Path) -> None:
    paths = [
        put(tmp_path / "a.parquet"),
        put(tmp_path / "b.parquet", step=10.003),
        put(tmp_path / "c.parquet"),
    ]
    found = imports(paths, tmp_path / "out")
    assert asyncio.run(found.write()) == 3
    for path in paths:
        session = Session.open(tmp_path / "out" / "sessions" / path.stem)
        fingertip = session.fingertip(Touch)
        assert fingertip is not None
        assert (fingertip.unit, fingertip.resolution, fingertip.cells) == ("kPa", 0.02, 2)
        [touch] = session.read(Touch, 0)
        given = pl.read_parquet(path)["p1"].to_numpy()
        assert touch.counts[:, 1] * fingertip.resolution == pytest.approx(given, abs=0.0101)
    assert {file["resolution"] for file in found.summary()["files"]} == {0.02}
    assert "  readings from 90 to 590.16 kPa\n  stored in steps of 0.02 kPa\n" in found.report()


def test_files_that_differ_give_warnings(tmp_path: Path) -> None:
    paths = [
        put(tmp_path / "a.parquet"),
        put(tmp_path / "b.parquet"),
        put(tmp_path / "odd.parquet", cells=3, rate=1000, low=-1),
    ]
    found = imports(paths, tmp_path / "out")
    assert found.warnings == [
        "the files differ in their cells: most have 2 cells, odd.parquet has 3 cells",
        "the files differ in being zeroed: most have none (raw), odd.parquet has negative readings (zeroed)",
        "the rates differ: 100 to 1000 Hz",
    ]


def test_an_error_of_many_files_is_one_line(tmp_path: Path) -> None:
    for name in "abc":
        (tmp_path / f"{name}.csv").write_text("clock,p0\n0,1\n" if name < "c" else "t,p0\nsoon,1\n")
    report = imports([tmp_path / f"{name}.csv" for name in "abc"], tmp_path / "out").report()
    first, second = (line for line in report.splitlines() if line.startswith("error: "))
    assert first.startswith(f"error: {tmp_path / 'a.csv'}, line 1: has the columns 'clock p0', none")
    assert first.endswith("(as in 1 other file)")
    assert second.startswith(f"error: {tmp_path / 'c.csv'}, line 2, column t: is 'soon'")


def test_a_file_that_changes_after_the_check_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("flows.lab.file_imports._KEPT_ROWS", 0)
    paths = [put(tmp_path / "a.parquet"), put(tmp_path / "b.parquet")]
    found = imports(paths, tmp_path / "out")
    put(paths[1], low=80)
    with pytest.raises(InputError, match=r"b.parquet: was changed while it was imported"):
        asyncio.run(found.write())


def test_only_complete_sessions_of_the_same_file_are_skipped(tmp_path: Path) -> None:
    first, second = put(tmp_path / "a.parquet"), put(tmp_path / "b.parquet", low=91)
    asyncio.run(imports([first], tmp_path / "out").write())
    found = imports([first, second], tmp_path / "out", skip_existing=True)
    assert asyncio.run(found.write()) == 1
    with pytest.raises(
        EndpointError, match="has a session 'a' of the same file: --skip-existing leaves it out"
    ):
        imports([first], tmp_path / "out")
    put(first, low=80)
    with pytest.raises(EndpointError, match="has a session 'a' of another file: rename the file"):
        imports([first], tmp_path / "out", skip_existing=True)


def test_an_incomplete_session_must_be_deleted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = put(tmp_path / "a.parquet")
    asyncio.run(imports([path], tmp_path / "out").write())
    about = json.loads((tmp_path / "out/sessions/a/session.json").read_text()) | {"complete": False}

    def incomplete(_folder: Path) -> dict[str, Any]:
        return dict(about)

    monkeypatch.setattr("flows.lab.file_imports.read_session", incomplete)
    with pytest.raises(EndpointError, match="session 'a' of the same file is incomplete: delete it"):
        imports([path], tmp_path / "out", skip_existing=True)


def test_progress_names_the_files(tmp_path: Path) -> None:
    paths, seen = [put(tmp_path / f"{name}.parquet") for name in "ab"], list[tuple[int, int, str]]()

    def progress(done: int, total: int, part: str) -> None:
        seen.append((done, total, part))

    found = imports(paths, tmp_path / "out", progress=progress)
    asyncio.run(found.write(progress))
    assert seen == [(0, 2, "a.parquet"), (1, 2, "b.parquet")] * 2
