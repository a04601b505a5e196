"""Processes that tests start, kill and read, and temporary folders."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

PATIENCE: Final = 120.0  # s, for anything that a process is expected to do
ROOT: Final = Path(__file__).parents[2]


class Child:
    """Process of `tests.chaos.children` whose lines of output are kept over restarts."""

    def __init__(self, folder: Path, name: str, *arguments: str | Path) -> None:
        """Prepare to run it, with its state and its output in `folder`."""
        self._command = [sys.executable, "-m", "tests.chaos.children", name, *map(str, arguments)]
        self._folder, self._output = folder, folder / f"{name}.output"
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start the process."""
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_STATE_HOME": str(self._folder / "state")}
        with self._output.open("ab") as output:
            self._process = subprocess.Popen(self._command, stdout=output, env=environment, cwd=ROOT)

    def stop(self, number: signal.Signals = signal.SIGKILL) -> None:
        """Send a signal that ends the process.

        Raises:
            subprocess.TimeoutExpired: if it does not end.
        """
        process, self._process = self._process, None
        if process:
            process.send_signal(number)
            process.wait(PATIENCE)

    def lines_with(self, keyword: str) -> list[str]:
        """Return the rest of each complete line of output that begins with a keyword."""
        complete = self._output.read_text().rpartition("\n")[0].splitlines()
        return [line.partition(" ")[2] for line in complete if line.startswith(keyword)]


def until(condition: Callable[[], bool], *, pause: float = 0.02) -> bool:
    """Check a condition every `pause` s until it holds; return False after two minutes."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(pause)
    return True


@contextmanager
def scratch() -> Generator[Path]:
    """Yield a temporary folder."""
    with TemporaryDirectory(prefix="chaos-") as folder:
        yield Path(folder)
