"""What a verification finds, and how it weighs it."""

import errno
import os
from pathlib import Path
from shutil import copyfile, copytree, rmtree
from unittest.mock import MagicMock

import pytest

from operators.batch import s
from operators.errors import InputError
from operators.ports import Gap, SinkStatus, SourceStatus
from storage import LabelSpan, Session, verify
from storage.parts import read_manifest, write_manifest
from tests.storage.made import new_episodes, new_run, side_by_side, write

BATCHES = side_by_side(5)
ENDLESS = (
    '{"version": 2, "session": "one", "sinks": {}, "streams": {"touch": {"gaps": [{"start": 0, "end": %s}]}}}'
)
ENDLESS %= "9" * 4000


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of the sessions one, of all the batches, and two, of the first five."""
    root = tmp_path_factory.mktemp("whole")
    write(root, new_run(), [*BATCHES, new_episodes((0, 9, "hold"))]).close()
    write(root, new_run("two"), BATCHES[:5]).close()
    return root


@pytest.fixture
def dataset(whole: Path, tmp_path: Path) -> Path:
    copytree(whole, tmp_path / "data")
    return tmp_path / "data"


def test_a_complete_dataset_is_good_and_its_rows_are_counted(dataset: Path) -> None:
    report = MagicMock()
    found = verify(dataset, report)
    assert (found.code, found.findings, found.sessions) == (0, (), 2)
    assert (found.files, found.rows) == (11 + 4, 126 + 25)
    assert report.call_args.args == (15, 15, "two")
    assert verify(dataset / "sessions/two").rows == 25


def test_a_flipped_bit_in_any_listed_file_or_the_manifest_is_found(whole: Path, tmp_path: Path) -> None:
    folder = copytree(whole / "sessions/one", tmp_path / "one")
    listed = read_manifest(folder)
    for path in [folder / "MANIFEST.json", *sorted(folder.rglob("*.parquet"))]:
        data = path.read_bytes()
        for seed in range(6):
            flipped = bytearray(data)
            flipped[(seed * 7919 + 31) % len(data)] ^= 1 << seed
            path.write_bytes(flipped)
            found = verify(folder)
            assert found.code == 1 or read_manifest(folder) == listed
            if found.code:
                assert path.name in found.findings[0].text
        path.write_bytes(data)


@pytest.mark.parametrize("left", ["MANIFEST.json", "touch/part-000000.parquet", "journal/000000.wal"])
def test_a_session_that_lost_its_description_is_lost(dataset: Path, left: str) -> None:
    rmtree(dataset / "sessions/one")
    place = dataset / "sessions/one" / left
    place.parent.mkdir(parents=True)
    place.write_bytes(b"{}")
    found = verify(dataset)
    assert (found.code, found.sessions) == (1, 2)
    assert any("its session.json is missing" in each.text for each in found.findings)


def test_a_manifest_with_fewer_rows_than_the_closed_session_counts_is_a_loss(tmp_path: Path) -> None:
    run = new_run()
    run.sinks["dataset"] = SinkStatus(rows=125, records=True)
    writer = write(tmp_path, run, BATCHES)
    writer.close()
    assert verify(tmp_path).code == 0
    listed = read_manifest(writer.folder)
    del listed["touch/part-000002.parquet"]  # as in a copy of an older manifest
    write_manifest(writer.folder, listed.values())
    found = {each.text.partition(":")[0]: each.weight for each in verify(tmp_path).findings}
    assert found == {
        "10 of the 125 recorded rows are in no part": "lost",
        "touch/part-000002.parquet": "repairable",
    }


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


def test_files_that_do_not_belong_to_the_session_are_reported(dataset: Path) -> None:
    folder = dataset / "sessions/two"
    data = (folder / "touch/part-000000.parquet").read_bytes()
    (folder / "touch/part-000001.parquet").write_bytes(data)
    (folder / "motion/part-000001.parquet.tmp").write_bytes(b"half")
    found = verify(folder)
    assert [each.weight for each in found.findings] == ["repairable", "note"]


def test_what_may_not_be_read_is_lost_and_the_check_goes_on(
    dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = Path.stat

    def stat(path: Path, *, follow_symlinks: bool = True) -> os.stat_result:
        if path.parent.name == "one":
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return real(path, follow_symlinks=follow_symlinks)

    monkeypatch.setattr(Path, "stat", stat)
    found = verify(dataset)
    assert (found.code, found.sessions) == (1, 2)
    assert any("cannot be read: Permission denied; grant this user" in each.text for each in found.findings)
    assert {each.session for each in found.findings} == {"one"}


@pytest.mark.parametrize("name", ["dataset.json", "sessions/one/session.json"])
@pytest.mark.parametrize("content", ["{", "[]", '{"version": "9"}', '{"version": 2, "sinks": [3]}', ENDLESS])
def test_a_description_that_cannot_be_read_is_lost(dataset: Path, name: str, content: str) -> None:
    if name == "dataset.json" and "sinks" in content:
        content = "{}"
    (dataset / name).write_text(content)
    assert verify(dataset).code == 1


@pytest.mark.parametrize("name", ["dataset.json", "sessions/one/session.json"])
def test_data_of_another_version_is_refused_because_nothing_is_lost(dataset: Path, name: str) -> None:
    (dataset / name).write_text('{"version": 1}')
    with pytest.raises(InputError, match=rf"{name}: has version 1; this slipflow reads version 2"):
        verify(dataset)


@pytest.fixture(params=["two", "one"])
def other(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A session of another dataset, with another name or only another start, with labels by hand."""
    run = new_run(request.param)
    run.start += s
    folder = write(tmp_path / "other", run, BATCHES).folder
    Session.open(folder).write_hand_labels([LabelSpan(0, 9, 0, "slip")], based_on=0)
    return folder


@pytest.mark.parametrize("document", ["session.json", "MANIFEST.json", "labels/000001.json"])
def test_a_document_of_another_session_is_refused(dataset: Path, other: Path, document: str) -> None:
    folder = dataset / "sessions/one"
    Session.open(folder).write_hand_labels([LabelSpan(0, 9, 0, "slip")], based_on=0)
    assert verify(dataset).code == 0
    copyfile(other / document, folder / document)
    found = verify(dataset)
    assert found.worst == "lost"
    assert any("belongs to session '" in each.text for each in found.findings)
    with pytest.raises(InputError, match="belongs to session"):
        Session.open(folder).hand_labels()


def test_a_renamed_session_is_noted_and_has_the_name_of_its_folder(dataset: Path) -> None:
    (dataset / "sessions/two").rename(dataset / "sessions/copy")
    assert Session.open(dataset / "sessions/copy").name == "copy"  # as of the files of an export
    [finding] = verify(dataset).findings
    assert (finding.session, finding.weight) == ("copy", "note")
    assert "its session.json names session 'two': restore its own, unless the folder" in finding.text
