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
from threading import Condition, Thread
from typing import Final

PATIENCE: Final = 120.0  # s, for anything that a process is expected to do
ROOT: Final = Path(__file__).parents[2]


class Child:
    """Process of `tests.chaos.children` whose lines of output are kept over restarts."""

    def __init__(self, folder: Path, name: str, *arguments: str | Path) -> None:
        """Prepare to run it, with its state in `folder`."""
        self._command = [sys.executable, "-m", "tests.chaos.children", name, *map(str, arguments)]
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None
        self._reader: Thread | None = None
        self.lines = list[str]()
        self._news = Condition()

    def start(self) -> None:
        """Start the process."""
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_STATE_HOME": str(self._folder / "state")}
        self._process = subprocess.Popen(self._command, stdout=subprocess.PIPE, env=environment, cwd=ROOT)
        self._reader = Thread(target=self._read, args=(self._process,), daemon=True)
        self._reader.start()

    def stop(self, number: signal.Signals | None = signal.SIGKILL) -> None:
        """Send a signal that ends the process (None: it ends by itself), and read the rest of its output.

        Raises:
            subprocess.TimeoutExpired: if it does not end.
        """
        process, reader, self._process = self._process, self._reader, None
        if process and reader:
            if number is not None:
                process.send_signal(number)
            process.wait(PATIENCE)
            reader.join()

    def wait_for(self, condition: Callable[[], bool]) -> bool:
        """Wait until a condition that depends on the output holds; return False after two minutes."""
        with self._news:
            return self._news.wait_for(condition, PATIENCE)

    def lines_with(self, keyword: str) -> list[str]:
        """Return the rest of each line that begins with a keyword."""
        return [line.partition(" ")[2] for line in self.lines.copy() if line.startswith(f"{keyword} ")]

    def _read(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout
        with process.stdout as lines:
            for line in lines:
                if line.endswith(b"\n"):  # else the kill cut the line
                    with self._news:
                        self.lines.append(line.decode().rstrip())
                        self._news.notify_all()


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
