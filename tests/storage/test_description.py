import os
from pathlib import Path

import pytest

from operators.batch import s
from storage import description, files
from storage.description import describe_dataset, describe_session, read_dataset, read_session
from tests.storage.made import new_run


@pytest.mark.parametrize(
    ("start", "text"),
    [
        (0, "1970-01-01T00:00:00.000000000Z"),
        (-1, "1969-12-31T23:59:59.999999999Z"),
        (1_790_000_000 * s + 123, "2026-09-21T14:13:20.000000123Z"),
    ],
)
def test_the_start_is_given_to_the_nanosecond_as_a_number_and_as_rfc_3339(
    tmp_path: Path, start: int, text: str
) -> None:
    run = new_run()
    run.start = start
    describe_session(tmp_path, run)
    about = read_session(tmp_path)
    assert (about["start_ns"], about["start"]) == (start, text)


def test_of_several_processes_that_begin_a_dataset_one_describes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def beaten(root: Path, *, wait: bool) -> int:
        """By a process that held the lock when we asked for it."""
        assert wait
        files.put_json(root / "dataset.json", {"format": "slipflow dataset", "version": 2, "by": "another"})
        return os.open(root, os.O_RDONLY)

    monkeypatch.setattr(description, "lock", beaten)
    describe_dataset(tmp_path)
    assert read_dataset(tmp_path)["by"] == "another"
