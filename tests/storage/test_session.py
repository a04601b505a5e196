from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from operators.batch import (
    Batch,
    Episodes,
    Faults,
    Labelled,
    Motion,
    Sample,
    Scores,
    Slips,
    Touch,
    Truth,
    Zeroed,
    ms,
)
from operators.errors import EndpointError, InputError, ParameterError
from operators.fingertip import TAKKTILE, Fingertip, grid
from operators.ports import Recording
from storage import Session, files, recover, verify
from storage.layout import TABLE_OF
from storage.parts import read_manifest, read_part, write_manifest, write_part
from tests.storage.made import new_batch, new_episodes, new_run, rows, side_by_side, write

KINDS: list[type[Batch]] = [Motion, Labelled, Slips, Faults, Episodes, Truth]


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """Two fingertips in three parts, and an episode."""
    touch = [
        new_batch(Touch, 10, start=turn * 100 * ms, finger=finger, seed=turn + 10 * finger)
        for turn in range(3)
        for finger in (2, 0)
    ]
    batches = [new_episodes((0, 50 * ms, "hold")), *touch, new_batch(Slips, 2)]
    write(tmp_path, new_run(live=False), batches).close()
    return tmp_path


@pytest.fixture
def folder(dataset: Path) -> Path:
    return dataset / "sessions/one"


@settings(deadline=None, max_examples=25)
@given(
    data=st.data(),
    cells=st.sampled_from([1, 6, 16, 128]),
    touch=st.sampled_from([Touch, Zeroed]),
    killed=st.booleans(),
)
def test_rows_of_all_types_and_any_number_of_cells_come_back_bit_for_bit_after_a_close_or_a_kill(
    tmp_path_factory: pytest.TempPathFactory,
    data: st.DataObject,
    cells: int,
    touch: type[Touch],
    *,
    killed: bool,
) -> None:
    root, batches = tmp_path_factory.mktemp("data"), list[Batch]()
    row = st.tuples(st.sampled_from([touch, *KINDS]), st.integers(0, 2), st.integers(1, 9))
    for turn, (kind, finger, count) in enumerate(data.draw(st.lists(row, max_size=30))):
        batches.append(new_batch(kind, count, start=20 * turn * ms, finger=finger, seed=turn, cells=cells))
    writer = write(root, new_run(), batches)
    folder = writer.folder
    if not killed:
        writer.close()
    del writer
    streams = {(type(batch), batch.finger): 0 for batch in batches}
    for batch in batches:
        streams[type(batch), batch.finger] += len(batch)
    assert rows(folder, batches, [*streams]) == [*streams.values()]
    session = Session.open(folder)
    for kind, finger in streams:
        assert max(map(len, session.read(kind, finger, 3))) <= 3
        table = TABLE_OF[kind]
        frame = pl.read_parquet(sorted(folder.glob(table.pattern)))
        assert frame.equals(session.frame(table.name))
        for name, column in table.columns.items():
            stored: Any = np.concatenate([getattr(each, name) for each in batches if type(each) is kind])
            expected = [column.names[code] for code in stored] if column.names else stored.tobytes()
            found = frame[name].to_list() if column.names else frame[name].to_numpy().tobytes()
            assert found == expected


def test_a_session_states_its_fingertip_or_it_is_measured(tmp_path: Path) -> None:
    run, pad = new_run(), Fingertip(grid(16), 1000.0, "kPa", 0.01, (0, 4000))
    run.fingertips = {str(tmp_path): {Touch: pad}}
    write(tmp_path, run, [new_batch(Touch, 9, cells=16)]).close()
    session = Session.open(tmp_path)
    assert session.fingertip(Touch) == session.fingertip(Zeroed) == pad
    assert session.fingertip(Labelled) is None
    about = {key: value for key, value in session.about.items() if key != "fingertips"}
    measured = replace(session, about=about).fingertip(Touch)
    assert measured is not None
    assert (measured.cells, measured.rate) == (16, 100.0)
    wrong = replace(session, about={**about, "fingertips": {"touch": {**TAKKTILE.describe(), "unit": ""}}})
    with pytest.raises(InputError, match=r"session\.json: has an invalid"):
        wrong.fingertip(Touch)


def test_streams_that_were_not_recorded_are_empty(dataset: Path) -> None:
    session: Recording = Session.open(dataset)
    assert (session.name, session.fingers(Touch), session.describe()["flow"]) == ("one", (0, 2), "slip")
    for kind in (Motion, Labelled, Faults, Zeroed, Sample, Scores):
        assert session.fingers(kind) == ()
        assert list(session.read(kind, 0)) == []
    assert list(session.read(Touch, 1)) == []


def test_a_table_it_does_not_hold_is_refused_by_naming_those_it_holds(dataset: Path) -> None:
    with pytest.raises(InputError, match="has no table 'motion'; it has touch, slips, episodes"):
        Session.open(dataset).frame("motion")
    with pytest.raises(ParameterError, match="rows is 0"):
        list(Session.open(dataset).read(Touch, 0, 0))


def test_a_dataset_of_several_sessions_lists_them(dataset: Path) -> None:
    write(dataset, new_run("two"), [])
    with pytest.raises(InputError, match=r"has 2 sessions: give one, such as .*/sessions/two; it has one"):
        Session.open(dataset)


def test_a_description_without_a_session_is_reported(folder: Path) -> None:
    (folder / "session.json").write_text('{"version": 2}')
    with pytest.raises(InputError, match=r'session\.json: has no "session"'):
        Session.open(folder)


def test_parts_without_a_batch_type_or_with_another_are_reported(folder: Path) -> None:
    path, listed = "touch/part-000001.parquet", read_manifest(folder)
    rows = read_part(folder, listed[path])
    metadata: list[dict[str, str]] = [{}, {"batch": "Motion"}, {"batch": "dict"}]
    for each in metadata:
        listed[path] = write_part(folder, path, rows.replace_schema_metadata(each))
        write_manifest(folder, listed.values())
        with pytest.raises(
            InputError, match=r"part-000001\.parquet: its metadata .* is no type of its table"
        ):
            list(Session.open(folder).read(Touch, 0))


THIRTY = side_by_side(6, [(Touch, 0)])


@pytest.mark.parametrize("live", [True, False])
def test_a_session_that_is_being_recorded_is_read_and_checked_as_far_as_it_is_committed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, *, live: bool
) -> None:
    writer = write(tmp_path, new_run(live=live), THIRTY)
    session = Session.open(tmp_path)
    assert session.about["complete"] is False
    assert len(session.frame("touch")) == 20
    found = verify(tmp_path)
    assert (found.code, [each.weight for each in found.findings], found.rows) == (0, ["note"], 20)
    with pytest.raises(EndpointError, match="one: is being recorded"):
        recover(session.folder)
    assert (tmp_path / "sessions/one/journal").exists() is live
    writer.close()
    assert not caplog.records
    assert len(Session.open(tmp_path).frame("touch")) == 30
    assert not (tmp_path / "sessions/one/journal").exists()


def test_on_a_read_only_disk_committed_rows_are_read_and_a_warning_is_logged_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*_: object) -> None:
        raise OSError(30, "Read-only file system")

    write(tmp_path, new_run(), THIRTY)
    with monkeypatch.context() as patch:
        patch.setattr(files, "put", fail)
        patch.setattr(files, "make_folder", fail)
        assert [len(Session.open(tmp_path).frame("touch")) for _ in range(2)] == [20, 20]
    [said] = [each for each in caplog.records if "the rows in its journal are not read" in each.getMessage()]
    assert "Read-only file system" in said.getMessage()
    assert len(Session.open(tmp_path).frame("touch")) == 30
