"""Python process that a test starts, kills and stops, and its output."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from threading import Condition, Lock, Thread
from typing import Final

PATIENCE: Final = 60.0  # s, for anything that a process is expected to do
PAUSE: Final = 0.1  # s, before a process that ended by itself is started again
ROOT: Final = Path(__file__).parents[2]
SLIPFLOW: Final = ("-m", "flows.cli")


class Child:
    """Python process whose output is read in a thread, and kept over restarts.

    If the process ends by itself, for example because there is no broker, it is started again, as a
    supervisor does.
    """

    def __init__(self, folder: Path, *arguments: str) -> None:
        """Prepare to run Python with `arguments`; its stderr goes to a file in `folder`."""
        self._command = [sys.executable, *arguments]
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None
        self._reader: Thread | None = None
        self._changing = Lock()  # held while the process is started or stopped
        self.lines = list[str]()
        self._news = Condition()

    def start(self) -> None:
        """Start the process."""
        with self._changing:
            self._process = self._begin()

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the process."""
        assert self._process
        self._process.send_signal(number)

    def kill(self) -> None:
        """Kill the process and read the rest of its output."""
        self._stop(signal.SIGKILL)

    def end(self) -> None:
        """Send SIGTERM and wait until the process ends.

        Raises:
            subprocess.TimeoutExpired: if it does not end.
        """
        self._stop(signal.SIGTERM)

    def _begin(self) -> subprocess.Popen[bytes]:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_STATE_HOME": str(self._folder / "state")}
        with (self._folder / "stderr").open("ab") as stderr:
            process = subprocess.Popen(
                self._command, stdout=subprocess.PIPE, stderr=stderr, env=environment, cwd=ROOT
            )
        self._reader = Thread(target=self._read, args=(process,), daemon=True)
        self._reader.start()
        return process

    def _stop(self, number: signal.Signals) -> None:
        with self._changing:
            process, reader, self._process = self._process, self._reader, None
        if process and reader:
            process.send_signal(number)
            process.wait(PATIENCE)
            reader.join()

    def wait_for(self, condition: Callable[[], bool]) -> bool:
        """Wait until a condition that depends on the output holds; return False after 60 s."""
        with self._news:
            return self._news.wait_for(condition, PATIENCE)

    def lines_with(self, keyword: str) -> list[str]:
        """Return the rest of each line that begins with a keyword."""
        return [line.partition(" ")[2] for line in self.lines.copy() if line.startswith(f"{keyword} ")]

    def memory(self) -> float:
        """Return the resident memory of the process, MB."""
        assert self._process
        return memory(self._process.pid)

    def _read(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout
        with process.stdout as lines:
            for line in lines:
                if line.endswith(b"\n"):  # else the kill cut the line
                    with self._news:
                        self.lines.append(line.decode().rstrip())
                        self._news.notify_all()
        process.wait()
        time.sleep(PAUSE)
        with self._changing:
            if self._process is process:
                self._process = self._begin()


def memory(process: int) -> float:
    """Return the resident memory of a process, MB."""
    [size] = re.findall(r"VmRSS:\s+(\d+) kB", Path(f"/proc/{process}/status").read_text())
    return int(size) / 1000


def until(condition: Callable[[], bool], *, pause: float = 0.02) -> bool:
    """Check a condition every `pause` s until it holds; return False after 60 s."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(pause)
    return True
