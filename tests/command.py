"""The command line as a user meets it: whole processes."""

import subprocess
import sys
from pathlib import Path
from typing import Final

SLIPFLOW: Final = (sys.executable, "-c", "from flows.cli.main import main; main()")


def slipflow(*arguments: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """What a command comes to that ends by itself."""
    command = [*SLIPFLOW, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, cwd=cwd)


def error(*arguments: str | Path, cwd: Path | None = None) -> str:
    """The one line that a mistake gives."""
    done = slipflow(*arguments, cwd=cwd)
    assert done.returncode == 2, done
    [line] = done.stderr.splitlines()
    assert line.startswith("error: ")
    return line.removeprefix("error: ")
