import os
import subprocess
import sys
from pathlib import Path

from storage.files import lock, lock_file, locked

HOLD = """
import sys
from pathlib import Path
from storage.files import lock_file
lock_file(Path(sys.argv[1]))
print("held", flush=True)
sys.stdin.read()
"""


def test_a_folder_is_locked_by_one_at_a_time(tmp_path: Path) -> None:
    assert not locked(tmp_path)
    held = lock(tmp_path)
    assert held is not None
    assert locked(tmp_path)
    assert lock(tmp_path) is None
    os.close(held)
    assert not locked(tmp_path)


def test_a_file_is_locked_until_its_process_is_killed(tmp_path: Path) -> None:
    path = tmp_path / "file"
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout
    assert process.stdout.readline() == "held\n"
    assert lock_file(path) is None
    process.kill()
    process.communicate()
    held = lock_file(path)
    assert held is not None
    os.close(held)
