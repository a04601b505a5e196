"""Recordings as sessions."""

import asyncio
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors import Trace
from connectors.files.column_map import ColumnMap
from flows.graph.testing import TestSink, TestSource
from flows.lab.importing import AttachLabels, TraceImport, import_files, import_frame
from flows.learn.labelled_recordings import common_fingertip, load
from flows.run.replay_runner import ReplayRunner
from flows.run.replays import session_of
from operators import Zero
from operators.batch import EVERY, Labelled, Motion, Touch, Zeroed, concat, ms, s
from operators.errors import InputError, ParameterError
from storage import Session
from tests.flows.run.live import flow_of
from tests.storage.made import contents

CELLS = "s1,s2,s3,s4,s5,s6"
GUESS = ColumnMap()


def write(folder: Path, header: str, rows: list[str], name: str = "trace.csv") -> Path:
    path = folder / name
    path.write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    return path


def counts(row: int, base: int = 500) -> str:
    return ",".join(str(base - 3 * row - cell) for cell in range(6))


def read(path: Path, out: Path, columns: ColumnMap = GUESS) -> TraceImport:
    return TraceImport(Trace(path, columns), out, session_of(path))


def imported(trace_import: TraceImport) -> Session:
    trace_import.write()
    return Session.open(trace_import.out)


def rows(session: Session, kind: Any, finger: int = 0) -> Any:
    return concat(kind, list(session.read(kind, finger)))


def test_the_file_s_labels_are_those_of_the_samples(tmp_path: Path) -> None:
    labels = [k % 3 - 1 for k in range(300)]
    path = write(
        tmp_path, f"t,{CELLS},label", [f"{k / 100},{counts(k % 9)},{label}" for k, label in enumerate(labels)]
    )
    session = imported(read(path, tmp_path / "out", ColumnMap.parse("counts.4=s*")))
    assert session.tables == ("touch", "samples")
    samples = rows(session, Labelled, 4)
    assert samples.label.tolist() == labels
    assert np.isnan(samples.velocity).all()
    assert np.isnan(samples.speed).all()
    assert samples.time.tolist() == [k * 10 * ms for k in range(300)]
    touch = rows(session, Touch, 4)
    assert type(touch) is Touch
    expected = Zero()
    zeroed = concat(Zeroed, [expected.push(touch), expected.flush()])
    assert samples.counts.tolist() == zeroed.counts.tolist()


@pytest.mark.parametrize(
    ("column", "fast", "labels", "absent"),
    [
        ("v", "400", "150 static, 150 unknown", "slip"),
        ("vx,vy,vz", "0,0,0.04", "300 static", "slip"),
        ("v", "40", "150 slip, 150 static", ""),
    ],
)
def test_without_labels_the_arm_s_speed_gives_them_and_a_missing_one_is_a_warning(
    tmp_path: Path, column: str, fast: str, labels: str, absent: str
) -> None:
    still = "0,0,0" if "," in column else "0"
    lines = [f"{k * 10},{counts(0)},{still if k < 150 else fast}" for k in range(300)]
    columns = ColumnMap.parse("units.speed=mm/s")
    trace_import = read(write(tmp_path, f"t_ms,{CELLS},{column}", lines), tmp_path / "out", columns)
    report = trace_import.report()
    assert f"  labels by arm speed, slip above 3 mm/s: {labels}\n" in report
    assert (f"  warning: no row is {absent}, but the arm moves: slip is a speed" in report) == bool(absent)
    session = imported(trace_import)
    assert session.tables == ("touch", "motion", "samples")
    assert "Label(" in str(session.about["declaration"])
    assert rows(session, Motion, EVERY).velocity[-1, :3].max() == (0.04 if "," in fast else int(fast) / 1000)
    expected = trace_import.labels().tolist()
    assert rows(session, Labelled).label.tolist() == expected == [0] * 150 + expected[150:]


def test_labels_and_motion_of_a_file_are_both_kept(tmp_path: Path) -> None:
    lines = [f"{k / 100},{counts(0, 3)},{0.1 if k % 2 else ''},{k % 2}" for k in range(300)]
    path = write(tmp_path, f"t,{CELLS},speed,slip", lines)
    session = imported(read(path, tmp_path / "out", ColumnMap(zeroed=True)))
    samples = rows(session, Labelled)
    assert type(rows(session, Touch)) is Zeroed
    assert samples.label.tolist() == [k % 2 for k in range(300)]
    assert len(rows(session, Motion, EVERY)) == 150
    assert samples.velocity[:, 0].tolist() == [0.1] * 300  # of the nearest row, within 20 ms


def test_a_file_with_counts_only_gives_touch_only(tmp_path: Path) -> None:
    others = ",".join(f"other_{letter}" for letter in "abcdefghijklmnopqrstuv")
    lines = [counts(k) + ",7" * 22 for k in range(9)]
    path = write(tmp_path, f"{CELLS},{others}", lines, "lab 3, night.csv")
    trace_import = read(path, tmp_path / "out", ColumnMap(rate=30))
    session = imported(trace_import)
    source: Any = session.about["sources"]
    assert source["touch"].pop("fingertip")["rate_hz"] == 30
    assert source["touch"] == trace_import.trace.describe()
    assert (session.name, session.about["complete"]) == ("lab-3-night", True)
    shown = " ".join(f"other_{letter}" for letter in "abcdefghijklmnopqrst")
    assert f"  not used {shown} and 2 more\n" in trace_import.report()
    assert session.tables == ("touch",)
    assert rows(session, Touch).time.tolist() == [round(k * 1e9 / 30) for k in range(9)]
    assert "no labels and no motion: no samples" in trace_import.report()


def test_an_imported_session_replays_like_its_trace_and_trains(tmp_path: Path) -> None:
    lines = [f"{k / 100},{counts(k % 7)},{k // 150 % 2}" for k in range(600)]
    trace_import = read(write(tmp_path, f"t,{CELLS},label", lines), tmp_path / "out")
    session = imported(trace_import)
    given = list[Any]()
    for recording in (trace_import.trace, session):
        sink = TestSink()
        flow = flow_of(TestSource(Touch), sink, through=[Zero(scans=10)])
        asyncio.run(ReplayRunner(flow, recording, "again").execute())
        given.append(sink.rows(Zeroed, 0))
    trace, replayed = given
    assert trace.time.tolist() == replayed.time.tolist()
    assert trace.counts.tolist() == replayed.counts.tolist()
    (trial,) = load(tmp_path / "out")
    assert trial.label.tolist() == [k // 150 % 2 for k in range(600)]
    assert trial.split == "train"


def test_a_folder_with_other_files_is_refused(tmp_path: Path) -> None:
    trace = write(tmp_path, f"t,{CELLS}", [f"{n / 100},{n % 2},2,3,4,5,6" for n in range(50)])
    out = tmp_path / "thesis"
    out.mkdir()
    (out / "chapter.txt").touch()
    with pytest.raises(InputError, match=r"thesis: has other files and is not a dataset: give another"):
        read(trace, out).write()
    assert [path.name for path in out.iterdir()] == ["chapter.txt"]


def test_an_implausible_speed_or_rate_gives_a_warning(tmp_path: Path) -> None:
    lines = [f"{k / 100},{counts(0)},{40 if k > 4 else 0}" for k in range(9)]
    path = write(tmp_path, f"t,{CELLS},v", lines)
    trace_import = read(path, tmp_path)
    assert "moves in 4 of 9 rows, above 0.003 m/s, at up to 40 m/s" in trace_import.report()
    [doubt] = trace_import.trace.part.warnings
    assert "at up to 40 m/s: is its speed in another unit?" in doubt
    assert read(path, tmp_path, ColumnMap(units={"speed": "mm/s"})).trace.part.warnings == ()
    [doubt] = read(path, tmp_path, ColumnMap(units={"speed": "mm/s", "time": "ms"})).trace.part.warnings
    assert "the rate is 1e+05 Hz" in doubt


@pytest.mark.parametrize("notebook", [False, True])
def test_a_frame_becomes_a_session(tmp_path: Path, *, notebook: bool) -> None:
    cells = {f"p{cell}": 101.3 + 0.01 * np.arange(300) for cell in range(4)}
    frame = pl.DataFrame({"t": np.arange(300) / 100, **cells, "state": ["slip", "static", None] * 100})

    async def inside_a_loop() -> TraceImport:
        return write_it()

    def write_it() -> TraceImport:
        text = "label=state,units.counts=kPa,layout=1x4"
        return import_frame(frame, tmp_path, "pad", text, group="wood", about={"rig": "bench"})

    report = (asyncio.run(inside_a_loop()) if notebook else write_it()).report()
    session = Session.open(tmp_path)
    assert report.endswith(f"session pad of {tmp_path}, finger 0, group wood")
    assert rows(session, Labelled).label.tolist() == [1, 0, -1] * 100
    tip = session.fingertip(Touch)
    assert tip is not None
    assert (tip.unit, tip.resolution, tip.layout) == ("kPa", 0.01, ((0, 1, 2, 3),))
    sources: Any = session.about["sources"]
    assert (session.about["group"], sources["touch"]["rig"]) == ("wood", "bench")
    write_it()  # the same data
    with pytest.raises(InputError, match="pad: another session has this name: write to another dataset"):
        import_frame(frame[:200], tmp_path, "pad", "label=state,units.counts=kPa,layout=1x4")
    with pytest.raises(InputError, match="one: has no two times, which tell the rate"):
        import_frame(frame[:1], tmp_path, "one", "label=state,units.counts=kPa")
    found = import_frame(frame[:1], tmp_path, "one", "label=state,units.counts=kPa,rate=100")
    assert "one: 1 row, 0.0 s, 100.0 Hz (slip: slip)\n" in found.report()
    with pytest.raises(ParameterError, match=r"session is '\.\./x'"):
        import_frame(frame, tmp_path, "../x", "units.counts=kPa")


def put(path: Path, *, step: float = 0.01, low: float = 90, time: str = "t") -> Path:
    numbers = np.arange(300)
    cells = {f"p{cell}": low + step * (numbers % 50 + cell) for cell in range(2)}
    pl.DataFrame({time: numbers / 100, **cells}).write_parquet(path)
    return path


def imports(paths: list[Path], out: Path, **settings: Any) -> list[Any]:
    done = import_files(paths, out, ColumnMap(units={"counts": "kPa"}), **settings)
    return [found for _path, found in done]


def test_files_are_imported_one_by_one_with_the_resolution_of_the_dataset(tmp_path: Path) -> None:
    paths = [put(tmp_path / "a.parquet"), put(tmp_path / "b.parquet", step=0.25)]
    assert [each.state for each in imports(paths, tmp_path / "out")] == ["written", "written"]
    [third] = imports([put(tmp_path / "c.parquet", step=0.003)], tmp_path / "out")
    finer = [put(tmp_path / f"{name}.parquet", step=0.0001) for name in "de"]
    complaint = "steps of 0.01 kPa, as in earlier files, make p0 p1 almost constant: import this file first"
    assert all(complaint in str(each) for each in imports(finer, tmp_path / "out"))
    assert "  warning: the readings are rounded to steps of 0.01 kPa" in third.report()
    for name in "abc":
        session = Session.open(tmp_path / "out" / "sessions" / name)
        fingertip = session.fingertip(Touch)
        assert fingertip is not None
        assert (fingertip.unit, fingertip.resolution, fingertip.cells) == ("kPa", 0.01, 2)
        touch = rows(session, Touch)
        expected = pl.read_parquet(tmp_path / f"{name}.parquet")["p1"].to_numpy()
        assert touch.counts[:, 1] * fingertip.resolution == pytest.approx(expected, abs=0.00501)


def test_a_recording_is_imported_once_under_any_name_and_keeps_its_map(tmp_path: Path) -> None:
    out, folder = tmp_path / "out", tmp_path / "trial"
    folder.mkdir()
    paths = [put(folder / "a.parquet"), put(tmp_path / "a.parquet", low=80)]
    assert [each.session for each in imports(paths, out)] == ["trial-a", f"{tmp_path.name}-a"]
    copied, before = put(tmp_path / "copy.parquet", low=80), contents(out)
    [again, moved] = imports([paths[0], copied], out)
    assert [(each.session, each.state) for each in (again, moved)] == [
        ("trial-a", "present"),
        (f"{tmp_path.name}-a", "present"),
    ]
    for text in ("units.counts=mbar", "units.counts=kPa,range=80:120", "units.counts=kPa,labelled=slip"):
        [(_, found)] = import_files(paths[:1], out, ColumnMap.parse(text))
        assert isinstance(found, TraceImport)
        assert (found.session, found.state) == ("trial-a", "present")
    assert contents(out) == before
    imports([copied], tmp_path / "other")
    put(copied, low=70)
    with pytest.raises(InputError, match="already has a session 'copy' of another file: rename the file"):
        imports([copied], tmp_path / "other")


def test_the_folder_of_a_file_may_state_its_split(tmp_path: Path) -> None:
    paths = list[Path]()
    for low, name in enumerate(("train", "trials", "validation", "test")):
        (tmp_path / name).mkdir()
        paths.append(put(tmp_path / name / f"{low}.parquet", low=low))
    found = [each.report().rpartition("finger 0")[2] for each in imports(paths, tmp_path / "out")]
    assert found == [", split train", "", ", split validation", ", split test"]
    sessions = [Session.open(folder) for folder in sorted((tmp_path / "out/sessions").iterdir())]
    assert [each.about["split"] for each in sessions] == ["train", None, "validation", "test"]


@pytest.mark.parametrize(
    "index",
    [
        pd.date_range("2026-05-01", periods=300, freq="10ms"),
        pd.date_range("2026-05-01", periods=300, freq="10ms", name="stamp", tz="Europe/Berlin"),
        pd.timedelta_range(0, periods=300, freq="10ms"),
        pd.Index(np.arange(300) / 100, name="t"),
    ],
)
def test_an_index_of_pandas_is_the_time(index: Any, tmp_path: Path) -> None:
    frame = pd.DataFrame({"p0": np.arange(300), "p1": np.arange(300)}, index=index)
    found = import_frame(frame, tmp_path, "pad")
    assert found.trace.part.columns.rate == 100
    assert found.trace.part.touch.time[0] == {"t": 0, "stamp": 1777586400 * s}.get(
        str(index.name), 1777593600 * s if hasattr(index, "tz") else 0
    )


@pytest.mark.parametrize(("unit", "cells"), [("count", 6), ("kPa", 6), ("count", 5)])
def test_what_is_assumed_is_printed(unit: str, cells: int, tmp_path: Path) -> None:
    frame = {f"p{cell}": 16_777_216 + np.arange(300.0) for cell in range(cells)}
    frame["t"] = np.arange(300) / 100
    report = TraceImport(Trace(frame, ColumnMap.parse(f"units.counts={unit}")), tmp_path, "pad").report()
    layout = "5,4,3/0,1,2" if cells == 6 else "0,1,2/3,4,-1"
    assert f"  layout   {layout}  (assumed; state layout=ROWSxCOLUMNS)\n" in report
    direction = "1023 counts, falling" if (unit, cells) == ("count", 6) else "the direction of the training"
    assert f"  range    unknown: detectors assume {direction}; state range=LOW:HIGH\n" in report
    assert "  readings from 16777216 to 16777515 " in report


@given(cuts=st.lists(st.integers(0, 30), max_size=8))
def test_labels_are_attached_to_their_rows_for_any_cut(cuts: list[int]) -> None:
    labels = tuple(k % 3 - 1 for k in range(30))
    zeros = np.zeros((30, 6), np.int16)
    touch = Zeroed(np.arange(30), zeros, zeros, zeros == 0, finger=1)
    operator = AttachLabels(labels)
    edges = [0, *sorted(cuts), 30]
    batches = [operator.push(touch[a:b]) for a, b in pairwise(edges)]
    given = concat(Labelled, [*batches, operator.flush()]).check()
    assert given.label.tolist() == list(labels)
    assert not given.matched.any()
    assert operator.reset_copy().push(touch[:2]).label.tolist() == [-1, 0]


def test_counts_of_one_sensor_are_trained_together(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    paths = list[Path]()
    for base in (500, 40_000, 40_101):  # counts of 16 bits
        cells = {f"p{cell}": base + rng.integers(0, 99, 300) for cell in range(2)}
        paths.append(tmp_path / f"{base}.parquet")
        pl.DataFrame({"t": np.arange(300) / 100, **cells, "slip": [0, 1] * 150}).write_parquet(paths[-1])
    assert len([*import_files(paths, tmp_path / "out", ColumnMap.parse("range=0:65535"))]) == 3
    recordings = load(tmp_path / "out")
    assert len(recordings) == 3
    assert common_fingertip(recordings).resolution == 1
