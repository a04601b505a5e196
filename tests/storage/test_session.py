import asyncio
import pickle
from collections.abc import Callable, Sequence
from pathlib import Path
from shutil import copyfile
from typing import Any

import pyarrow as pa
import pytest

from operators.batch import Batch, Faults, Labelled, Motion, Sample, Scores, Slips, Touch, Zeroed, concat, ms
from operators.errors import InputError, ParameterError
from operators.ports import Recording, Run
from storage import Dataset, Session, files, parts
from storage.layout import TOUCH
from storage.parts import read_manifest, read_part, write_manifest, write_part
from storage.schema import schema, to_arrow
from storage.writer import SessionWriter
from tests.storage.made import new_batch, new_episodes, new_run, same


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """Two fingertips in three parts, and an episode."""

    async def main() -> None:
        sink = Dataset(tmp_path, part_span=100 * ms)
        await sink.open(new_run())
        await sink.write(new_episodes((0, 50 * ms, "hold")))
        for turn in range(3):
            for finger in (2, 0):
                batch = new_batch(Touch, 10, start=turn * 100 * ms, finger=finger, seed=turn + 10 * finger)
                await sink.write(batch)
        await sink.write(new_batch(Slips, 2))
        await sink.close()

    asyncio.run(main())
    return tmp_path


@pytest.fixture
def folder(dataset: Path) -> Path:
    return dataset / "sessions/one"


def test_a_session_is_a_recording(dataset: Path) -> None:
    recording: Recording = Session.open(dataset)
    assert recording.name == "one"
    assert recording.fingers(Touch) == (0, 2)
    assert recording.describe()["flow"] == "slip"


def test_a_file_that_is_replaced_after_its_check_is_refused(folder: Path) -> None:
    session = Session.open(folder)
    assert session.fingers(Touch) == (0, 2)
    copyfile(folder / TOUCH.file(0), folder / TOUCH.file(1))
    with pytest.raises(InputError, match="sha256 differs from the manifest"):
        list(session.read(Touch, 0))


def test_all_columns_of_a_checked_file_are_held_to_the_limit(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = Session.open(folder)
    session.fingers(Touch)
    monkeypatch.setattr(parts, "UNPACKED_LIMIT", 100)
    with pytest.raises(InputError, match="unpacks to more than"):
        list(session.read(Touch, 0))


@pytest.mark.parametrize("rows", [1, 3, 10, 1000])
def test_rows_come_in_the_order_recorded_and_in_bounded_batches(dataset: Path, rows: int) -> None:
    batches = list(Session.open(dataset).read(Touch, 2, rows))
    assert max(map(len, batches)) == min(rows, 10)
    written = [new_batch(Touch, 10, start=n * 100 * ms, finger=2, seed=n + 20) for n in range(3)]
    same(concat(Touch, batches), concat(Touch, written))


def test_streams_that_were_not_recorded_are_empty(dataset: Path) -> None:
    session = Session.open(dataset)
    for kind in (Motion, Labelled, Faults, Zeroed, Sample, Scores):
        assert session.fingers(kind) == ()
        assert list(session.read(kind, 0)) == []
    assert list(session.read(Touch, 1)) == []


def test_a_batch_of_no_rows_is_refused(dataset: Path) -> None:
    with pytest.raises(ParameterError, match="rows is 0"):
        list(Session.open(dataset).read(Touch, 0, 0))


def test_a_table_it_does_not_hold_is_refused_by_naming_those_it_holds(dataset: Path) -> None:
    with pytest.raises(InputError, match="has no table 'motion'; it has touch, slips, episodes"):
        Session.open(dataset).frame("motion")


def test_a_session_opens_by_its_own_folder(folder: Path) -> None:
    assert Session.open(folder).name == "one"


def test_a_dataset_of_several_sessions_lists_them(dataset: Path) -> None:
    asyncio.run(Dataset(dataset).open(new_run("two")))
    with pytest.raises(
        InputError, match=r"has 2 sessions: give one, such as .*/sessions/two; it has one, two$"
    ):
        Session.open(dataset)


def test_a_folder_that_is_not_a_dataset_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty/sessions").mkdir(parents=True)
    for name, complaint in (
        ("missing", "missing: there is no such folder"),
        ("", r"is not a session \(no session\.json\) and not a dataset"),
        ("empty", "empty: has no session"),
    ):
        with pytest.raises(InputError, match=complaint):
            Session.open(tmp_path / name)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("{", "is not valid JSON"),
        ("[]", "is not a JSON object"),
        ('{"version": 9, "session": "one"}', "has version 9; this slipflow reads version 2"),
        ('{"version": 2}', 'has no "session"'),
    ],
)
def test_a_damaged_description_is_reported(folder: Path, text: str, complaint: str) -> None:
    (folder / "session.json").write_text(text)
    with pytest.raises(InputError, match=rf"session\.json: {complaint}"):
        Session.open(folder)


def test_a_missing_part_is_reported(folder: Path) -> None:
    (folder / "touch/part-000001.parquet").unlink()
    with pytest.raises(InputError, match=r"part-000001\.parquet: cannot be read: No such file"):
        list(Session.open(folder).read(Touch, 0))


def test_a_damaged_part_is_reported_wherever_it_is_read(folder: Path) -> None:
    path = folder / "touch/part-000001.parquet"
    data = bytearray(path.read_bytes())
    data[300] ^= 1
    path.write_bytes(data)
    session = Session.open(folder)
    readers: list[Callable[[], object]] = [
        lambda: list(session.read(Touch, 0)),
        lambda: session.fingers(Touch),
        lambda: session.frame("touch"),
    ]
    for read in readers:
        with pytest.raises(InputError, match=r"part-000001\.parquet: is damaged"):
            read()


def test_parts_without_a_batch_type_or_with_different_ones_are_reported(folder: Path) -> None:
    path, listed = "touch/part-000001.parquet", read_manifest(folder)
    rows = read_part(folder / path, schema(TOUCH), listed[path].sha256)
    metadata: list[dict[str, str]] = [{}, {"batch": "Motion"}, {"batch": "Zeroed"}, {"batch": "dict"}]
    for each in metadata:
        listed[path] = write_part(folder, path, rows.replace_schema_metadata(each))
        write_manifest(folder, listed.values())
        with pytest.raises(
            InputError, match=r"part-000001\.parquet: its metadata \"batch\" is missing or differs"
        ):
            list(Session.open(folder).read(Touch, 0))


def test_a_part_that_is_a_link_is_refused(folder: Path, tmp_path: Path) -> None:
    path = folder / "touch/part-000000.parquet"
    path.rename(tmp_path / "elsewhere.parquet")
    path.symlink_to(tmp_path / "elsewhere.parquet")
    with pytest.raises(InputError, match=r"part-000000\.parquet: is a link; a session must have none"):
        Session.open(folder).frame("touch")


def test_fingertips_that_are_read_side_by_side_share_each_part(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = list[str]()

    def watched(path: Path, *more: Any) -> pa.Table:  # noqa: ANN401 - as read_part takes them
        read.append(path.name)
        return read_part(path, *more)

    monkeypatch.setattr("storage.session.read_part", watched)
    session = Session.open(folder)
    for _ in zip(session.read(Touch, 0, 10), session.read(Touch, 2, 10), strict=True):
        pass
    assert read == [f"part-{number:06d}.parquet" for number in range(3)]


def test_a_part_being_read_is_not_read_as_another_type(folder: Path) -> None:
    session = Session.open(folder)
    raw, zeroed = session.read(Touch, 0), session.read(Zeroed, 0)
    assert len(next(raw)) == 10
    assert list(zeroed) == []


def test_no_part_is_kept_once_it_has_been_read(folder: Path) -> None:
    session = Session.open(folder)
    assert len(list(session.read(Touch, 0))) == 3
    assert not vars(session)["_open"]


def test_the_files_are_checked_once_for_whose_rows_they_hold(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = Session.open(folder)
    assert session.fingers(Touch) == (0, 2)
    monkeypatch.setattr(parts, "read_part", None)
    assert session.fingers(Touch) == (0, 2)


def test_the_file_of_a_short_session_is_read_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = list[Path]()

    def counted(path: Path, *args: Any) -> Any:  # noqa: ANN401 - as `read_part`
        opened.append(path)
        return read_part(path, *args)

    monkeypatch.setattr("storage.session.read_part", counted)
    session = Session.open(folder)
    assert (session.fingers(Slips), session.fingers(Touch)) == ((0,), (0, 2))
    assert len(list(session.read(Slips, 0))) == 1
    assert [path.name for path in opened if path.parent.name != "touch"] == ["slips.parquet"]
    assert not vars(session)["_open"]


def test_a_session_pickles_while_it_is_read(folder: Path) -> None:
    session = Session.open(folder)
    rows = session.read(Touch, 0)
    next(rows)
    again = pickle.loads(pickle.dumps(session))  # noqa: S301 - our own
    assert again == session
    assert again.fingers(Touch) == (0, 2)


def record(root: Path, run: Run, batches: Sequence[Batch]) -> SessionWriter:
    """As a sink does, but for the end: who forgets the writer leaves the session as a crash does."""
    writer = SessionWriter(root, run, part_span=100 * ms, part_rows=1000)
    for batch in batches:
        if writer.full(batch):
            writer.commit()
        if not writer.add(batch):
            writer.append(batch)
    return writer


@pytest.fixture
def thirty() -> list[Batch]:
    return [new_batch(Touch, 5, start=turn * 50 * ms, seed=turn) for turn in range(6)]


@pytest.mark.parametrize("live", [True, False])
def test_a_session_that_is_being_recorded_is_read_as_far_as_it_is_committed(
    tmp_path: Path, thirty: list[Batch], *, live: bool
) -> None:
    writer = record(tmp_path, new_run(live=live), thirty)
    session = Session.open(tmp_path)
    assert session.about["complete"] is False
    assert len(session.frame("touch")) == 20
    assert (tmp_path / "sessions/one/journal").exists() is live
    writer.close()
    assert len(Session.open(tmp_path).frame("touch")) == 30
    assert not (tmp_path / "sessions/one/journal").exists()


def test_an_unlisted_part_is_not_read(tmp_path: Path, thirty: list[Batch]) -> None:
    writer = record(tmp_path, new_run(), thirty[:2])
    folder = tmp_path / "sessions/one"
    (folder / "touch").mkdir()
    write_part(folder, "touch/part-000000.parquet", to_arrow(TOUCH, thirty[:2]))
    assert Session.open(folder).tables == ()
    writer.close()
    assert len(Session.open(folder).frame("touch")) == 10


def test_a_session_of_a_killed_recorder_is_recovered_when_opened(tmp_path: Path, thirty: list[Batch]) -> None:
    record(tmp_path, new_run(), thirty)
    session = Session.open(tmp_path)
    assert len(session.frame("touch")) == 30
    assert session.about["recovered"] == {"rows": {"touch": 10}, "lost": [], "cut": []}
    assert not (tmp_path / "sessions/one/journal").exists()


def test_on_a_read_only_disk_committed_rows_are_read_and_a_warning_is_logged_once(
    tmp_path: Path, thirty: list[Batch], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*_: object) -> None:
        raise OSError(30, "Read-only file system")

    record(tmp_path, new_run(), thirty)
    with monkeypatch.context() as patch:
        patch.setattr(files, "put", fail)
        patch.setattr(files, "make_folder", fail)
        assert [len(Session.open(tmp_path).frame("touch")) for _ in range(2)] == [20, 20]
    [said] = [each for each in caplog.records if "the rows in its journal are not read" in each.getMessage()]
    assert "Read-only file system" in said.getMessage()
    assert len(Session.open(tmp_path).frame("touch")) == 30
