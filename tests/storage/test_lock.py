import os
import subprocess
import sys
from pathlib import Path
from threading import Thread

import pytest

from storage.lock import lock, locked


def test_a_folder_is_locked_by_one_at_a_time(tmp_path: Path) -> None:
    assert not locked(tmp_path)
    held = lock(tmp_path)
    assert held is not None
    assert locked(tmp_path)
    assert lock(tmp_path) is None
    os.close(held)
    assert not locked(tmp_path)


def test_a_lock_ends_with_the_process_that_holds_it(tmp_path: Path) -> None:
    code = f"""
import pathlib, sys
from storage.lock import lock
lock(pathlib.Path({str(tmp_path)!r}))
print(1, flush=True)
sys.stdin.read()
"""
    with subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=Path(__file__).parents[2],
    ) as process:
        assert process.stdout
        assert process.stdout.readline() == b"1\n"
        assert locked(tmp_path)
        process.kill()
    assert not locked(tmp_path)


def test_who_waits_gets_it_next(tmp_path: Path) -> None:
    held, got = lock(tmp_path), list[int | None]()
    assert held is not None
    waiter = Thread(target=lambda: got.append(lock(tmp_path, wait=True)))
    waiter.start()
    assert got == []
    os.close(held)
    waiter.join(60)
    [number] = got
    assert number is not None
    os.close(number)


def test_what_is_not_there_cannot_be_locked(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        lock(tmp_path / "nowhere")
    assert not locked(tmp_path / "nowhere")
