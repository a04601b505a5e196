"""The command line in processes of its own."""

import subprocess
import sys
from pathlib import Path
from typing import Final

SLIPFLOW: Final = (sys.executable, "-m", "flows.cli")


def slipflow(*arguments: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    command = [*SLIPFLOW, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, cwd=cwd)


def error(*arguments: str | Path, cwd: Path | None = None) -> str:
    """Return the one-line error of a command, without its prefix."""
    done = slipflow(*arguments, cwd=cwd)
    assert done.returncode == 2, done
    [line] = done.stderr.splitlines()
    assert line.startswith("error: ")
    return line.removeprefix("error: ")
