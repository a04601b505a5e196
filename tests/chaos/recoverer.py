"""Recovery that kills itself at a step on the disk, as a process.

python -m tests.chaos.recoverer SESSION STEP
"""

import os
import signal
import sys
from itertools import count
from pathlib import Path

from storage import recover
from tests.storage.disk_steps import observed


def main() -> None:
    """Recover a session up to a step."""
    folder, last = Path(sys.argv[1]), int(sys.argv[2])
    numbers = count()

    def reach(_: str) -> None:
        if next(numbers) == last:
            os.kill(os.getpid(), signal.SIGKILL)

    with observed(reach):
        recover(folder)


if __name__ == "__main__":
    main()
