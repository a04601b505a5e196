import errno
import os
from dataclasses import replace
from pathlib import Path
from shutil import copytree

import pytest

from operators.batch import Labelled, ms
from operators.errors import InputError
from operators.ports import Gap, SinkStatus, SourceStatus
from storage import recover, verify
from storage.layout import TOUCH
from storage.manifest import read_manifest, write_manifest
from storage.parts import read_part
from storage.schema import schema
from tests.storage.made import leave, new_batch, new_run, side_by_side, two_sessions, write

BATCHES = side_by_side(5)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return two_sessions(tmp_path_factory.mktemp("whole"), BATCHES)


@pytest.fixture
def dataset(whole: Path, tmp_path: Path) -> Path:
    copytree(whole, tmp_path / "data")
    return tmp_path / "data"


def test_a_missing_part_is_lost(dataset: Path) -> None:
    (dataset / "sessions/one/touch/part-000001.parquet").unlink()
    found = verify(dataset)
    assert found.code == 1
    [finding] = found.findings
    assert finding.session == "one"
    assert "part-000001.parquet: cannot be read: No such file" in finding.text


def test_rows_that_the_manifest_counts_otherwise_are_lost(dataset: Path) -> None:
    folder = dataset / "sessions/two"
    parts = [*read_manifest(folder).values()]
    write_manifest(folder, [*parts[1:], replace(parts[0], rows=6)])
    assert verify(folder).code == 1


def test_samples_out_of_the_order_of_time_are_found(tmp_path: Path) -> None:
    write(tmp_path, new_run(), [new_batch(Labelled, 3, start=50 * ms), new_batch(Labelled, 3)]).close()
    found = verify(tmp_path)
    assert (found.code, len(found.findings)) == (3, 1)
    assert "are not in order of time" in found.findings[0].text


def test_a_journal_waits_to_be_recovered_and_what_was_recovered_stays_known(tmp_path: Path) -> None:
    leave(tmp_path, new_run(), BATCHES)
    before = verify(tmp_path)
    assert before.code == 3
    assert "slipflow recover" in before.findings[0].text
    recover(tmp_path / "sessions/one")
    after = verify(tmp_path)
    assert (after.code, after.rows) == (3, 125)
    assert "was recovered: 10 rows of touch" in after.findings[0].text


def test_a_journal_that_is_damaged_in_the_middle_is_lost(tmp_path: Path) -> None:
    leave(tmp_path, new_run(), BATCHES)
    path = max(tmp_path.rglob("0*.wal"))
    data = bytearray(path.read_bytes())
    last = data.rindex(b"SLIP")
    data[data.rindex(b"SLIP", 0, last) + 15] ^= 1  # the frame before the last
    path.write_bytes(data)
    assert [each.weight for each in verify(tmp_path).findings] == ["repairable", "lost"]


def test_a_session_that_is_being_recorded_is_good_as_far_as_it_is_committed(tmp_path: Path) -> None:
    writer = write(tmp_path, new_run(), BATCHES)
    found = verify(tmp_path)
    assert (found.code, [each.weight for each in found.findings]) == (0, ["note"])
    assert found.rows == 80
    writer.close()


def test_what_session_json_says_is_weighed(tmp_path: Path) -> None:
    run = new_run()
    run.sources["touch"] = SourceStatus(gaps=[Gap(0, 2_500_000_000, "unplugged")])
    run.sinks |= {"lab": SinkStatus(dropped=7, records=True), "dataset-view": SinkStatus(dropped=3)}
    write(tmp_path, run, BATCHES).close()
    found = {each.text: each.weight for each in verify(tmp_path).findings}
    assert found == {
        "7 rows for lab were dropped": "lossy",
        "3 rows for dataset-view were dropped": "note",
        "touch was down for 2.5 s: unplugged": "note",
    }


def test_files_that_nobody_lists_are_told_of(dataset: Path) -> None:
    folder = dataset / "sessions/two"
    (folder / "touch/part-000001.parquet").write_bytes((folder / "touch/part-000000.parquet").read_bytes())
    (folder / "motion/part-000001.parquet.tmp").write_bytes(b"half")
    assert [each.weight for each in verify(folder).findings] == ["repairable", "note"]


def test_a_file_that_nobody_lists_and_nobody_can_read_is_lost(dataset: Path) -> None:
    folder = dataset / "sessions/two"
    (folder / "MANIFEST.json").unlink()
    (folder / "touch/part-000000.parquet").write_bytes(b"half")
    found = {each.text for each in verify(folder).findings if each.weight == "lost"}
    assert any("is damaged or not a Parquet file" in each and "not in the manifest" in each for each in found)


def test_what_may_not_be_looked_into_is_lost_and_the_check_goes_on(
    dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = Path.stat

    def stat(path: Path, *, follow_symlinks: bool = True) -> os.stat_result:
        if path.parent.name == "one":
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return real(path, follow_symlinks=follow_symlinks)

    whole = verify(dataset)
    monkeypatch.setattr(Path, "stat", stat)
    found = verify(dataset)
    assert (found.code, found.names) == (1, whole.names)
    assert any("cannot be read: Permission denied; grant this user" in each.text for each in found.findings)
    assert {each.session for each in found.findings} == {"one"}


@pytest.mark.parametrize("name", ["dataset.json", "sessions/one/session.json"])
@pytest.mark.parametrize(
    "content", ["{", '{"version": "9"}', '{"version": 2, "session": "one", "sinks": [3]}']
)
def test_a_description_that_cannot_be_read_is_lost(dataset: Path, name: str, content: str) -> None:
    if name == "dataset.json" and content != "{":
        content = "[]" if "sinks" in content else "{}"
    (dataset / name).write_text(content)
    assert verify(dataset).code == 1


@pytest.mark.parametrize("name", ["dataset.json", "sessions/one/session.json"])
def test_data_of_another_version_is_refused_because_nothing_is_lost(dataset: Path, name: str) -> None:
    (dataset / name).write_text('{"version": 1}')
    with pytest.raises(InputError, match=rf"{name}: has version 1; this slipflow reads version 2"):
        verify(dataset)


def test_what_a_lost_part_held_is_told(dataset: Path) -> None:
    (dataset / "sessions/two/touch/part-000000.parquet").unlink()
    assert verify(dataset).findings[0].text.endswith("No such file or directory; it had 10 rows, 0.0 s")


def test_rows_that_a_closed_session_counts_are_missed_where_no_manifest_tells_of_them(tmp_path: Path) -> None:
    run = new_run()
    run.sinks["dataset"] = SinkStatus(rows=125, records=True)
    writer = write(tmp_path, run, BATCHES)
    writer.close()
    folder = writer.folder
    assert verify(folder).code == 0
    last = max(folder.glob("touch/*.parquet"))
    rows = len(read_part(last, schema(TOUCH)))
    last.unlink()
    (folder / "MANIFEST.json").unlink()
    text = f"{rows} of the 125 recorded rows are in no part"
    assert recover(folder).lost == (text,)
    assert [each.text for each in verify(folder).findings if each.weight == "lost"] == [
        f"lost before it was recovered: {text}"
    ]
