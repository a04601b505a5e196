import os
import subprocess
import sys
from pathlib import Path

import pytest

from connectors.mqtt.lock import lock_beside

HOLD = """
import sys
from pathlib import Path
from connectors.mqtt.lock import lock_beside
lock_beside(Path(sys.argv[1]))
print("held", flush=True)
sys.stdin.read()
"""


def test_a_file_is_held_by_one_process_until_that_is_killed(tmp_path: Path) -> None:
    path = tmp_path / "file"
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout
    assert process.stdout.readline() == "held\n"
    with pytest.raises(BlockingIOError):
        lock_beside(path)
    process.kill()
    process.communicate()
    os.close(lock_beside(path))


def test_the_file_itself_is_left_alone_and_a_refusal_leaves_nothing_open(tmp_path: Path) -> None:
    held = lock_beside(tmp_path / "file")
    before = len(list(Path("/proc/self/fd").iterdir()))
    with pytest.raises(BlockingIOError):
        lock_beside(tmp_path / "file")
    assert len(list(Path("/proc/self/fd").iterdir())) == before
    assert [path.name for path in tmp_path.iterdir()] == ["file.lock"]
    os.close(held)


def test_a_folder_that_is_not_there_is_the_systems_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        lock_beside(tmp_path / "absent" / "file")
