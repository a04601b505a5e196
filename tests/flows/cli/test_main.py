"""The command line in processes of its own: help, version and usage errors."""

import os
import re
import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from ctypes import CFUNCTYPE
from functools import partial
from pathlib import Path
from subprocess import PIPE
from time import sleep

import pytest

from flows.cli import __main__, main
from tests.command import SLIPFLOW, captured, slipflow
from tests.storage.made import new_run, side_by_side, write
from tests.waiting import PATIENCE


def test_debug_shows_the_traceback() -> None:
    done = slipflow("--debug", "run", "nowhere.py")
    assert done.returncode == 2
    assert done.stderr.startswith("Traceback")
    assert done.stderr.endswith("InputError: nowhere.py: there is no such file\n")


def test_output_that_cannot_be_written_is_one_line() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([*SLIPFLOW, "--version"], stdout=full, stderr=PIPE, text=True, check=False)
    assert done.returncode == 2
    assert re.fullmatch("error: standard output: No space left on device; free some .*\n", done.stderr)


@pytest.mark.parametrize(
    "call", [lambda kill: kill(), lambda kill: CFUNCTYPE(None)(kill)()], ids=["code", "callback of LLVM"]
)
def test_a_terminated_command_deletes_its_unfinished_output(
    call: Callable[[Callable[[], None]], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def terminate(*_: object) -> None:
        assert signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL  # it would end the tests
        assert (tmp_path / "out.partial").is_dir()
        call(partial(os.kill, os.getpid(), signal.SIGTERM))  # a callback swallows exceptions
        sleep(PATIENCE)

    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)  # restored
    monkeypatch.setattr("flows.lab.simulation._record", terminate)
    monkeypatch.setattr(sys, "argv", ["slipflow", "simulate", str(tmp_path / "out"), "--jobs", "1"])
    before = [(number, signal.getsignal(number)) for number in (signal.SIGTERM, signal.SIGHUP)]
    try:
        with pytest.raises(SystemExit) as ended:
            __main__.main()
    finally:
        for number, handler in before:
            signal.signal(number, handler)
    assert ended.value.code == 130
    assert [*tmp_path.iterdir()] == []


def test_ctrl_backslash_names_the_line_in_progress(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text("import os\nos.kill(os.getpid(), 3)\n")
    done = captured(*SLIPFLOW, "check", tmp_path / "own.py")
    assert 'own.py", line 2' in done.stderr


def test_a_closed_pipe_ends_quietly() -> None:
    with subprocess.Popen(["true"], stdin=PIPE) as reader:
        reader.wait()
        done = subprocess.run([*SLIPFLOW, "--help"], stdout=reader.stdin, stderr=PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, "")


@pytest.mark.parametrize(
    ("before", "code", "output"), [("default_int_handler", 130, ""), ("SIG_IGN", 0, "slipflow 0.2.0\n")]
)
def test_ctrl_c_in_imports_is_quiet_unless_the_parent_ignores_it(before: str, code: int, output: str) -> None:
    script = f"""
import os, signal, sys
signal.signal(signal.SIGINT, signal.{before})
class Interrupting:
    def find_spec(self, name, *_):
        if name == "flows.cli.options":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupting())
from flows.cli.__main__ import main
main()
"""
    done = captured(sys.executable, "-c", script, "--version")
    assert (done.returncode, done.stdout, done.stderr) == (code, output, "")


@pytest.mark.parametrize("limit", [100, 250, 420])  # MB
def test_a_lack_of_memory_is_one_line_whatever_library_meets_it(tmp_path: Path, limit: int) -> None:
    write(tmp_path, new_run(), side_by_side(5)).close()
    bound = partial(resource.setrlimit, resource.RLIMIT_AS, (limit * 10**6, limit * 10**6))
    done = captured(*SLIPFLOW, "verify", tmp_path, preexec_fn=bound)
    assert done.returncode in ({2} if limit < 300 else {0, 2}), done.stderr
    if done.returncode:
        [line] = done.stderr.splitlines()
        assert line.startswith("error: ")
        assert "there is not enough memory" in line


@pytest.mark.parametrize("command", [("verify", "recordings"), ("check", "record"), ("run", "demo")])
def test_a_command_in_a_deleted_folder_is_one_line(tmp_path: Path, command: tuple[str, ...]) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    deleting = "sh", "-c", 'rmdir "$PWD" && exec "$@"', "sh"
    env = os.environ | {"PYTHONPATH": str(Path(main.__file__).parents[2])}
    done = captured(*deleting, *SLIPFLOW, *command, cwd=gone, env=env)
    expected = "error: the current folder: was deleted or may not be read: change to another\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", expected)


def hiding(cause: BaseException) -> Exception:
    """Return an ImportError that hides another error, as extension modules raise it."""
    error = ImportError("initialization failed")
    error.__context__ = cause
    return error


def test_an_error_is_explained_unless_it_is_one_of_slipflow() -> None:
    assert main.explanation(hiding(KeyboardInterrupt())) == (130, "")
    assert main.explanation(hiding(ValueError())) == (0, "")
    assert main.explanation(RuntimeError("broken")) == (0, "")
    lacking = [MemoryError(), OSError(12, "Cannot allocate memory"), RuntimeError("can't start new thread")]
    for error in (*lacking, ImportError("libarrow.so.2600: failed to map segment from shared object")):
        assert main.explanation(error) == (2, "error: there is not enough memory")
    code, text = main.explanation(ModuleNotFoundError("No module named 'numba'", name="numba.core"))
    assert (code, text) == (2, f"error: numba is not installed: {sys.executable} -m pip install numba")
    assert main.explanation(ModuleNotFoundError("No module named 'mine'", name="mine")) == (0, "")
