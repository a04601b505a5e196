"""CSV traces as sessions."""

import asyncio
import hashlib
import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.files.column_map import ColumnMap
from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from flows.lab.importing import AttachLabels, TraceImport
from flows.learn.labelled_recordings import load
from flows.run.replay_runner import ReplayRunner
from operators import Label, Zero
from operators.batch import EVERY, Labelled, Motion, Touch, Zeroed, concat, ms
from operators.errors import EndpointError, InputError, ParameterError
from storage import Session

Write = Callable[..., Path]
CELLS = "s1,s2,s3,s4,s5,s6"
GUESS = ColumnMap()


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write_lines(header: str, rows: list[str], name: str = "trace.csv") -> Path:
        path = tmp_path / name
        path.write_text("\n".join([header, *rows, ""]), encoding="utf-8")
        return path

    return write_lines


def counts(row: int, base: int = 500) -> str:
    return ",".join(str(base - 3 * row - cell) for cell in range(6))


def imported(trace_import: TraceImport) -> Session:
    asyncio.run(trace_import.write())
    return Session.open(trace_import.summary()["dataset"])


def rows(session: Session, kind: Any, finger: int = 0) -> Any:  # noqa: ANN401 - batches of that kind
    return concat(kind, list(session.read(kind, finger)))


def test_the_file_s_labels_are_those_of_the_samples(tmp_path: Path, write: Write) -> None:
    labels = [k % 3 - 1 for k in range(300)]
    path = write(f"t,{CELLS},label", [f"{k / 100},{counts(k % 9)},{label}" for k, label in enumerate(labels)])
    session = imported(TraceImport(path, tmp_path / "out", GUESS, finger=4))
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


def test_without_labels_the_arm_s_speed_gives_them(tmp_path: Path, write: Write) -> None:
    speeds = [0 if k < 150 else 40 for k in range(300)]
    lines = [f"{k * 10},{counts(0)},{v}" for k, v in enumerate(speeds)]
    path = write(f"t_ms,{CELLS},v", lines)
    columns = ColumnMap.parse("", "speed=mm/s")
    trace_import = TraceImport(path, tmp_path / "out", columns, label=Label(speed=0.02, delay=30 * ms))
    session = imported(trace_import)
    assert session.tables == ("touch", "motion", "samples")
    assert rows(session, Motion, EVERY).velocity[:, 0].tolist() == [v / 1000 for v in speeds]
    assert rows(session, Labelled).label.tolist() == [0] * 147 + [1] * 152 + [-1]
    assert "  labels by arm speed, slip above 20 mm/s, 30 ms after the sample\n" in trace_import.report()
    assert "Label(speed=0.02, delay=30 ms)" in str(session.about["declaration"])


def test_labels_and_motion_of_a_file_are_both_kept(tmp_path: Path, write: Write) -> None:
    lines = [f"{k / 100},{counts(0, 3)},{0.1 if k % 2 else ''},{k % 2}" for k in range(300)]
    session = imported(TraceImport(write(f"t,{CELLS},speed,slip", lines), tmp_path / "out", GUESS))
    samples = rows(session, Labelled)
    assert type(rows(session, Touch)) is Zeroed
    assert samples.label.tolist() == [k % 2 for k in range(300)]
    assert len(rows(session, Motion, EVERY)) == 150
    assert samples.velocity[:, 0].tolist() == [0.1] * 300  # of the nearest row, within 20 ms


def test_a_file_with_counts_only_gives_touch_only(tmp_path: Path, write: Write) -> None:
    trace_import = TraceImport(write(CELLS, [counts(k) for k in range(9)]), tmp_path / "out", GUESS, rate=50)
    session = imported(trace_import)
    assert session.tables == ("touch",)
    assert rows(session, Touch).time.tolist() == [k * 20 * ms for k in range(9)]
    assert "no labels and no motion: no samples" in trace_import.report()


def test_the_session_describes_its_file(tmp_path: Path, write: Write) -> None:
    path = write(f"stamp,{CELLS},x", [f"{k},{counts(0)},0" for k in range(5)], "lab 3, night.csv")
    columns = ColumnMap.parse("label=x", "time=ms")
    session = imported(TraceImport(path, tmp_path / "out", columns))
    assert session.name == "lab-3-night"
    source: Any = session.about["sources"]
    assert source["touch"].pop("fingertip")["rate_hz"] == 1000
    assert source["touch"] == {
        "trace": "lab 3, night.csv",
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "rows": 5,
        "zeroed": False,
        "columns": {"time": ["stamp"], "counts": CELLS.split(","), "label": ["x"]},
        "units": {"time": "ms", "counts": "count"},
    }
    assert session.about["complete"] is True


def test_an_imported_session_replays_like_its_trace_and_trains(tmp_path: Path, write: Write) -> None:
    lines = [f"{k / 100},{counts(k % 7)},{k // 150 % 2}" for k in range(600)]
    trace_import = TraceImport(write(f"t,{CELLS},label", lines), tmp_path / "out", GUESS)
    session = imported(trace_import)
    given = list[Any]()
    for recording in (trace_import.trace, session):
        flow, sink = Flow("replay"), TestSink()
        (flow.source(TestSource(Touch)) | Zero(scans=10)).to(sink)
        asyncio.run(ReplayRunner(flow, recording, "again").execute())
        given.append(sink.rows(Zeroed, 0))
    trace, replayed = given
    assert trace.time.tolist() == replayed.time.tolist()
    assert trace.counts.tolist() == replayed.counts.tolist()
    (trial,) = load(tmp_path / "out")
    assert trial.label.tolist() == [k // 150 % 2 for k in range(600)]
    assert trial.split == "train"


def test_a_folder_with_other_files_is_refused(tmp_path: Path, write: Write) -> None:
    trace = write(f"t,{CELLS}", [f"{n / 100},{n % 2},2,3,4,5,6" for n in range(50)])
    out = tmp_path / "thesis"
    out.mkdir()
    (out / "chapter.txt").touch()
    with pytest.raises(
        InputError, match=r"thesis: has other files and is not a dataset: give another folder"
    ):
        asyncio.run(TraceImport(trace, out, GUESS).write())
    assert [path.name for path in out.iterdir()] == ["chapter.txt"]


def test_progress_reports_the_rows_written(tmp_path: Path, write: Write) -> None:
    progress = list[int]()
    trace_import = TraceImport(
        write(f"t,{CELLS}", [f"{k},{counts(0)}" for k in range(2500)]), tmp_path / "data", GUESS
    )
    asyncio.run(trace_import.write(progress.append))
    assert progress == [1000, 2000, 2500]


def test_the_interpretation_is_reported_before_anything_is_written(tmp_path: Path, write: Write) -> None:
    lines = [f"{k / 50},{counts(0)},{k / 100},{k % 2}" for k in range(11)]
    path = write(f"T,{CELLS},force,contact", lines)
    trace_import = TraceImport(path, tmp_path / "out", ColumnMap.parse("label=contact,speed=force"))
    found = trace_import.summary()
    assert json.loads(json.dumps(found)) == found
    assert found["recognised"] == ["time", "counts"]
    assert found["labels"] == {"slip": 5, "static": 6, "unknown": 0}
    assert (found["seconds"], found["rate"], found["fastest"]) == (0.2, pytest.approx(50), 0.1)
    assert trace_import.report().splitlines() == [
        f"{path}: 11 rows, 0.2 s, 50.0 Hz",
        "  time     T  (s, recognised by name)",
        "  counts   s1 s2 s3 s4 s5 s6  (raw, recognised by name)",
        "  speed    force  (m/s)",
        "  label    contact",
        "  readings from 495 to 500 counts",
        "  the arm moves in 10 of 11 rows, above 0.003 m/s, at up to 0.1 m/s",
        "  labels of the file: 5 slip, 6 static",
        f"session trace of {tmp_path / 'out'}, finger 0",
    ]
    assert not (tmp_path / "out").exists()


def test_an_implausible_speed_or_rate_gives_a_warning(tmp_path: Path, write: Write) -> None:
    lines = [f"{k / 100},{counts(0)},{40 if k > 4 else 0}" for k in range(9)]
    path = write(f"t,{CELLS},v", lines)
    trace_import = TraceImport(path, tmp_path, GUESS)
    assert "moves in 4 of 9 rows, above 0.003 m/s, at up to 40 m/s" in trace_import.report()
    [doubt] = trace_import.summary()["warnings"]
    assert "at up to 40 m/s: is its speed in cm/s (0.4 m/s) or mm/s (0.04 m/s)?" in doubt
    assert TraceImport(path, tmp_path, ColumnMap.parse("", "speed=mm/s")).summary()["warnings"] == []
    [doubt] = TraceImport(path, tmp_path, ColumnMap.parse("", "speed=mm/s,time=ms")).summary()["warnings"]
    assert "the rate is 1e+05 Hz" in doubt


def test_a_given_rate_must_match_the_times(tmp_path: Path, write: Write) -> None:
    path = write(f"t,{CELLS}", [f"{k * 10},{counts(0)}" for k in range(9)])
    with pytest.raises(InputError, match=r"has 0\.1 rows per second, not 100: is its time in another unit"):
        TraceImport(path, tmp_path, GUESS, rate=100)
    assert TraceImport(path, tmp_path, ColumnMap(units={"time": "ms"}), rate=95).trace.rate == pytest.approx(
        100
    )


def test_a_session_is_not_written_twice_and_has_a_name_of_its_own(tmp_path: Path, write: Write) -> None:
    path = write(f"t,{CELLS}", [f"{k},{counts(0)}" for k in range(9)], "...csv")
    assert imported(TraceImport(path, tmp_path / "out", GUESS)).name == "trace"
    with pytest.raises(EndpointError, match="already has a session 'trace'"):
        asyncio.run(TraceImport(path, tmp_path / "out", GUESS).write())
    with pytest.raises(ParameterError, match=r"session is '\.\./x'"):
        asyncio.run(TraceImport(path, tmp_path / "out", GUESS, session="../x").write())


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
