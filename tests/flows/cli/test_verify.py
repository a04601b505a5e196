"""`slipflow verify` as a process."""

from pathlib import Path
from shutil import copytree

import pytest

from operators import Touch
from storage import Session
from tests.command import slipflow
from tests.storage.made import leave, new_run, side_by_side, write


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """A dataset with a closed session and one whose recorder was killed."""
    batches = side_by_side(1, [(Touch, 0)])
    write(tmp_path, new_run("closed"), batches).close()
    leave(tmp_path, new_run("crashed"), batches)
    return tmp_path


def test_a_crash_is_reported_repaired_and_noted(dataset: Path) -> None:
    done = slipflow("verify", dataset)
    assert done.returncode == 3, done.stderr
    assert "repairable  crashed: has a journal: slipflow verify --repair" in done.stdout
    assert "all rows on disk can be recovered: add --repair" in done.stdout
    done = slipflow("verify", dataset, "--repair")
    assert done.returncode == 3, done.stderr
    assert done.stdout.startswith("crashed: recovered 5 rows of touch\n")
    assert "2 sessions, 2 files, 10 rows: repaired, all rows on disk were recovered" in done.stdout
    assert "touch; what the recorder could not write before it was killed is unknown\n" in done.stdout
    assert len(Session.open(dataset / "sessions/crashed").frame("touch")) == 5
    assert slipflow("verify", dataset, "--repair").stdout == done.stdout.partition("\n")[2]
    (dataset / "sessions/closed").rename(dataset / "sessions/\udcff\x1b\n")
    assert "\\udcff\\x1b\\n: its session.json names session 'closed'" in slipflow("verify", dataset).stdout
    (dataset / "sessions/\udcff\x1b\n").rename(dataset / "sessions/closed")
    done = slipflow("verify", ".", cwd=dataset / "sessions/closed")
    assert (done.returncode, "1 session, 1 file, 5 rows: all data is present" in done.stdout) == (0, True)


def test_the_other_sessions_are_repaired_if_one_cannot_be(
    dataset: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    (dataset / "sessions/closed/session.json").write_text("{")
    outside = copytree(dataset / "sessions/closed", tmp_path_factory.mktemp("outside") / "closed")
    (dataset / "sessions/a-link").symlink_to(outside)
    done = slipflow("verify", dataset, "--repair")
    assert done.returncode == 1
    assert done.stdout.startswith("crashed: recovered 5 rows of touch\n")
    assert "recorded data is lost" in done.stdout.splitlines()[-1]
    assert "session.json: is not valid JSON" in done.stderr
    assert "a-link: is a link; a session must have none" in done.stderr
