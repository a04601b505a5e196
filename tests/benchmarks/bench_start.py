"""CPU that commands take to answer: `--help`, `check live`, and `demo` until its page is served.

Run by `make bench`. Each command runs in a process of its own, in turns; the first turn, which compiles and
fills caches of files, does not count. CPU is user and system time.
"""

import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from tests.benchmarks.machine import print_head, take_turns

COMMAND: Final = [sys.executable, "-m", "flows.cli"]
SERVED: Final = "live page: "  # begins the line that names the address of the page
TICKS: Final = os.sysconf("SC_CLK_TCK")  # per second
TURNS: Final = 5


def answered(*words: str) -> float:
    """CPU of a command from its start to its end, s."""
    before = os.times()
    subprocess.run([*COMMAND, *words], check=True, capture_output=True)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


@contextmanager
def served_demo() -> Generator[tuple[int, str]]:
    """The demo in a process of its own, from when its page is served: the process and the page's address."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["demo", "--for", "10min", "--no-browser", "--out", f"{folder}/recordings"]
        demo = subprocess.Popen(
            [*COMMAND, *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        try:
            assert demo.stderr
            served = next((line for line in demo.stderr if SERVED in line), None)
            if served is None:
                raise SystemExit("the demo ended before its page was served")
            yield demo.pid, served.partition(SERVED)[2].split()[0]
        finally:
            demo.terminate()
            demo.communicate()


def page_served() -> float:
    """CPU of the demo from its start until its page is served, s."""
    with served_demo() as (process, _):
        times = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        return (int(times[11]) + int(times[12])) / TICKS  # utime and stime, see proc(5)


def main() -> None:
    """Measure and print the table."""
    print_head(f"medians of {TURNS} turns")
    commands = {
        "--help": lambda: answered("--help"),
        "check live": lambda: answered("check", "live"),
        "demo, until its page is served": page_served,
    }
    print(f"{'':42}{'CPU, s':>8}")
    for name, found in take_turns(commands, TURNS).items():
        print(f"{name:42}{statistics.median(found):8.2f}")


if __name__ == "__main__":
    main()
