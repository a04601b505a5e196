"""A process that is started, killed and stopped, and what it says."""

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

PATIENCE: Final = 60.0  # s, for anything that a process must do
PAUSE: Final = 0.1  # s, before what ended by itself is started again
ROOT: Final = Path(__file__).parents[2]
SLIPFLOW: Final = ("-m", "flows.cli")


class Child:
    """A Python process, over all its lives; its lines are read as they come.

    When it ends by itself, since there was no broker, say, it is started again, as a supervisor does.
    """

    def __init__(self, folder: Path, *arguments: str) -> None:
        """Get ready to start Python with `arguments`; what it complains of goes to a file in `folder`."""
        self._command = [sys.executable, *arguments]
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None
        self._reader: Thread | None = None
        self._changing = Lock()  # held while it is started or stopped
        self.lines = list[str]()
        self._news = Condition()

    def start(self) -> None:
        """Start it."""
        with self._changing:
            self._process = self._begin()

    def send(self, number: signal.Signals) -> None:
        """Send it a signal."""
        assert self._process
        self._process.send_signal(number)

    def kill(self) -> None:
        """Kill it; all that it said has been read then."""
        self._stop(signal.SIGKILL)

    def end(self) -> None:
        """Ask it to end, and wait until it has.

        Raises:
            subprocess.TimeoutExpired: if it does not.
        """
        self._stop(signal.SIGTERM)

    def _begin(self) -> subprocess.Popen[bytes]:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_STATE_HOME": str(self._folder / "state")}
        with (self._folder / "complaints").open("ab") as complaints:
            process = subprocess.Popen(
                self._command, stdout=subprocess.PIPE, stderr=complaints, env=environment, cwd=ROOT
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
        """Wait until something holds that changes with what it says; False if it does not within 60 s."""
        with self._news:
            return self._news.wait_for(condition, PATIENCE)

    def said(self, word: str) -> list[str]:
        """The rest of each line that begins with a word."""
        return [line.partition(" ")[2] for line in self.lines.copy() if line.startswith(f"{word} ")]

    def memory(self) -> float:
        """What it holds in memory, MB."""
        assert self._process
        return memory(self._process.pid)

    def _read(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout
        with process.stdout as lines:
            for line in lines:
                if line.endswith(b"\n"):  # else a kill cut it
                    with self._news:
                        self.lines.append(line.decode().rstrip())
                        self._news.notify_all()
        process.wait()
        time.sleep(PAUSE)
        with self._changing:
            if self._process is process:
                self._process = self._begin()


def memory(process: int) -> float:
    """What a process holds in memory, MB."""
    [size] = re.findall(r"VmRSS:\s+(\d+) kB", Path(f"/proc/{process}/status").read_text())
    return int(size) / 1000


def until(condition: Callable[[], bool], *, pause: float = 0.02) -> bool:
    """Look every `pause` s until something holds; False if it does not within 60 s."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(pause)
    return True
