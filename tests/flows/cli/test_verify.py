"""`slipflow verify` and `slipflow recover` in processes of their own."""

import json
import os
from pathlib import Path
from shutil import copyfile, copytree

import numpy as np
import pytest

from flows.run.clocks import EventClock
from operators.batch import BAROMETERS, Touch, ms
from operators.ports import Run
from storage import Session
from storage.lock import lock
from storage.writer import SessionWriter
from tests.command import slipflow


def record(root: Path, session: str, *, close: bool) -> Path:
    writer = SessionWriter(root, Run(session, "slip", EventClock(0), 0), 10**12, 1000)
    six = np.zeros((5, BAROMETERS), np.int16)
    writer.append(Touch(np.arange(5) * 10 * ms, six, six, six == 0, finger=0))
    if close:
        writer.close()
    return writer.folder


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """A dataset with a closed session and one whose recorder was killed."""
    record(tmp_path, "closed", close=True)
    record(tmp_path, "crashed", close=False)
    return tmp_path


def test_a_crash_is_reported_repaired_and_noted(dataset: Path) -> None:
    done = slipflow("verify", dataset)
    assert done.returncode == 3, done.stderr
    assert "repairable  crashed: has a journal: slipflow recover" in done.stdout
    assert "repairable, all rows on disk can be recovered" in done.stdout
    done = slipflow("recover", dataset)
    assert done.returncode == 3, done.stderr
    assert done.stdout == "crashed: recovered 5 rows of touch\n"
    assert len(Session.open(dataset / "sessions/crashed").frame("touch")) == 5
    done = slipflow("recover", dataset)
    assert done.returncode == 0
    assert done.stdout == "2 sessions, nothing to recover; slipflow verify reads every file\n"
    done = slipflow("verify", dataset)
    assert done.returncode == 3
    assert "2 sessions, 2 files, 10 rows: repaired, all rows on disk were recovered" in done.stdout
    assert "touch; what the recorder could not write before it was killed is unknown\n" in done.stdout
    done = slipflow("verify", dataset / "sessions/closed")
    assert (done.returncode, "1 session, 1 file, 5 rows: all data is present" in done.stdout) == (0, True)


def test_a_lost_part_is_reported_as_text_and_json(dataset: Path) -> None:
    (dataset / "sessions/closed/touch/part-000000.parquet").unlink()
    done = slipflow("verify", dataset / "sessions/closed", "--json")
    found = json.loads(done.stdout.splitlines()[-1])
    assert (done.returncode, found["code"], found["findings"][0]["weight"]) == (1, 1, "lost")
    done = slipflow("verify", dataset)
    assert done.returncode == 1
    assert "recorded data is lost" in done.stdout.splitlines()[-1]


def test_a_complete_session_is_good_in_json(dataset: Path) -> None:
    done = slipflow("verify", dataset / "sessions/closed", "--json")
    found = json.loads(done.stdout)
    assert (done.returncode, found["code"], found["worst"]) == (0, 0, "good")


def test_recover_prints_its_result_as_json(dataset: Path) -> None:
    done = slipflow("recover", dataset, "--json")
    found = json.loads(done.stdout.splitlines()[-1])
    assert (done.returncode, found["errors"]) == (3, [])
    assert [each["rows"] for each in found["sessions"]] == [{}, {"touch": 5}]


def test_a_session_being_recorded_is_skipped_without_error(dataset: Path) -> None:
    held = lock(dataset / "sessions/crashed")
    assert held is not None
    done = slipflow("recover", dataset)
    assert (done.returncode, "crashed: skipped, it is being recorded" in done.stderr) == (0, True)
    done = slipflow("verify", dataset)
    assert (done.returncode, "is being recorded" in done.stdout) == (0, True)
    os.close(held)


def test_the_other_sessions_are_recovered_if_one_cannot_be(dataset: Path) -> None:
    (dataset / "sessions/closed/session.json").write_text("{")
    done = slipflow("recover", dataset)
    assert done.returncode == 1
    assert "crashed: recovered 5 rows of touch" in done.stdout
    assert "session.json: is not valid JSON" in done.stderr


def test_a_copied_session_and_a_link_do_not_stop_the_others(
    dataset: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    outside = copytree(dataset / "sessions/closed", tmp_path_factory.mktemp("outside") / "closed")
    copytree(dataset / "sessions/closed", dataset / "sessions/my copy")
    (dataset / "sessions/a-link").symlink_to(outside)
    done = slipflow("recover", dataset)
    assert (done.returncode, done.stdout) == (1, "crashed: recovered 5 rows of touch\n")
    assert "a-link: is a link that leads out of" in done.stderr
    done = slipflow("recover", dataset)
    assert (done.returncode, done.stdout) == (1, "")  # not "nothing to recover" next to an error
    (dataset / "sessions/a-link").unlink()
    assert slipflow("recover", dataset).returncode == 0
    assert Session.open(dataset / "sessions/my copy").fingers(Touch) == (0,)


def test_a_session_without_its_description_is_named(dataset: Path) -> None:
    (dataset / "sessions/closed/session.json").unlink()
    done = slipflow("recover", dataset)
    assert done.returncode == 1
    assert "sessions/closed: session.json is missing" in done.stderr
    done = slipflow("verify", dataset, "--json")
    found = json.loads(done.stdout.splitlines()[-1])
    assert (done.returncode, found["sessions"], found["rows"], found["worst"]) == (1, 2, 10, "lost")


def test_recover_lists_its_changes(dataset: Path) -> None:
    folder = dataset / "sessions/closed"
    copyfile(folder / "touch/part-000000.parquet", folder / "touch/part-000001.parquet")
    done = slipflow("recover", folder)
    assert done.returncode == 3
    assert "touch/part-000001.parquet: is a copy of touch/part-000000.parquet" in done.stdout


def test_a_missing_folder_is_reported(tmp_path: Path) -> None:
    for command in ("verify", "recover"):
        done = slipflow(command, tmp_path / "nowhere")
        assert done.returncode == 2
        assert "Traceback" not in done.stderr
        assert "nowhere: there is no such folder" in done.stderr


def test_verify_writes_a_page_with_the_same_exit_code(dataset: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.html"
    done = slipflow("verify", dataset, "--report", report, "--json")
    assert done.returncode == 3, done.stderr
    assert json.loads(done.stdout)["worst"] == "repairable"
    assert f"wrote {report}" in done.stderr
    text = report.read_text()
    assert "repairable, all rows on disk can be recovered</h1>" in text
    assert "crashed" in text
    done = slipflow("verify", dataset, "-o", tmp_path / "nowhere" / "report.html")
    assert (done.returncode, done.stdout) == (2, "")
    assert f"report.html: folder {tmp_path / 'nowhere'} does not exist" in done.stderr
    assert not (tmp_path / "nowhere").exists()
    done = slipflow("verify", dataset, "-o", tmp_path / "report.txt")
    assert (done.returncode, done.stdout) == (2, "")
    assert "ends in .html" in done.stderr
