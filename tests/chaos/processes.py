"""Processes that are started to be killed, or to say what they found, and folders for what they leave."""

import os
import signal
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.chaos.child import PATIENCE, ROOT

MEMORY = Path("/dev/shm")  # noqa: S108 - a folder of a name of its own is made there


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
    """SIGKILL.

    Raises:
        RuntimeError: with what it said, if it had ended by itself.
    """
    child.kill()
    _, said = child.communicate()
    if child.returncode != -signal.SIGKILL:
        raise RuntimeError(f"{child.args!r} ended with {child.returncode}: {said}")


def finish(child: subprocess.Popen[str], seconds: float = 0) -> str:
    """What a child printed until its end, which should come in so many seconds.

    Raises:
        RuntimeError: with what it said, if it failed.
    """
    try:
        printed, said = child.communicate(timeout=seconds + PATIENCE)
    finally:
        child.kill()
    if child.returncode:
        raise RuntimeError(f"{child.args!r} ended with {child.returncode}: {said}")
    return printed


@contextmanager
def scratch(*, memory: bool = False) -> Generator[Path]:
    """A folder for a while; `memory`: where a file is durable at once, if there is such a place."""
    place = MEMORY if memory and MEMORY.is_dir() else None
    with TemporaryDirectory(dir=place, prefix="chaos-") as folder:
        yield Path(folder)
