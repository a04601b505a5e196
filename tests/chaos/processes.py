"""Child processes of tests, and temporary folders."""

import os
import signal
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.chaos.child import PATIENCE, ROOT

MEMORY = Path("/dev/shm")  # noqa: S108 - only the parent of temporary folders


def start(name: str, *arguments: str | Path) -> subprocess.Popen[str]:
    """Start ``python -m tests.chaos.<name>``."""
    return start_script("-m", f"tests.chaos.{name}", *arguments)


def start_script(*arguments: str | Path) -> subprocess.Popen[str]:
    """Start ``python <arguments>`` in the repository's root."""
    command = [sys.executable, *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, env=environment
    )


def kill(child: subprocess.Popen[str]) -> None:
    """Kill a process with SIGKILL.

    Raises:
        RuntimeError: with its stderr, if it had ended by itself.
    """
    child.kill()
    _, stderr = child.communicate()
    if child.returncode != -signal.SIGKILL:
        raise RuntimeError(f"{child.args!r} ended with {child.returncode}: {stderr}")


def finish(child: subprocess.Popen[str], seconds: float = 0) -> str:
    """Wait for the end of a process, due in `seconds`, and return its stdout.

    Raises:
        RuntimeError: with its stderr, if it failed.
    """
    try:
        stdout, stderr = child.communicate(timeout=seconds + PATIENCE)
    finally:
        child.kill()
    if child.returncode:
        raise RuntimeError(f"{child.args!r} ended with {child.returncode}: {stderr}")
    return stdout


@contextmanager
def scratch(*, memory: bool = False) -> Generator[Path]:
    """Yield a temporary folder; with `memory` in a file system in memory, if there is one."""
    parent = MEMORY if memory and MEMORY.is_dir() else None
    with TemporaryDirectory(dir=parent, prefix="chaos-") as folder:
        yield Path(folder)
