"""The command line: run to its end in this process, or started in a process of its own."""

import logging
import os
import subprocess
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from io import BytesIO, StringIO, TextIOWrapper
from pathlib import Path
from typing import Any, Final
from unittest.mock import patch

from flows.cli import main

SLIPFLOW: Final = (sys.executable, "-m", "flows.cli")  # for a process that is interrupted or killed


class Terminal(StringIO):
    """Stream that is a terminal."""

    def isatty(self) -> bool:
        return True


def captured(*words: str | Path, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a process to its end, whatever its exit code, and return its output."""
    return subprocess.run(words, capture_output=True, text=True, check=False, **options)


def slipflow(*arguments: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command to its end in this process; without `--jobs` it starts no others."""
    out, err = (TextIOWrapper(BytesIO(), "utf-8", write_through=True) for _ in range(2))
    command = ["slipflow", *map(str, arguments)]
    root, ours = logging.getLogger(), logging.getLogger("slipflow")
    handlers, root.handlers[:] = root.handlers[:], []
    level, code = ours.level, 0
    try:
        with (
            redirect_stdout(out),
            redirect_stderr(err),
            patch.object(sys, "argv", command),
            patch.object(main, "_debug", new=False),
            patch.object(os, "cpu_count", return_value=1),  # a process for each core takes seconds to start
            chdir(cwd or "."),
        ):
            main.main()
    except SystemExit as done:
        code = int(done.code or 0)
    finally:
        root.handlers[:] = handlers
        ours.setLevel(level)
    texts = (stream.buffer.getvalue().decode() for stream in (out, err))
    return subprocess.CompletedProcess(command, code, *texts)


def succeed(*arguments: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command that must succeed to its end in this process."""
    done = slipflow(*arguments, cwd=cwd)
    assert done.returncode == 0, f"{done.args}\n{done.stdout}\n{done.stderr}"
    return done


def error(*arguments: str | Path, cwd: Path | None = None) -> str:
    """Return the one-line error of a command, without its prefix."""
    done = slipflow(*arguments, cwd=cwd)
    assert done.returncode == 2, done
    [line] = done.stderr.splitlines()
    assert line.startswith("error: ")
    return line.removeprefix("error: ")
