"""Work of the executor's tests, in a module that workers can import."""

import os
import signal
import time
from pathlib import Path
from typing import Any


def work(item: str) -> Any:
    """Do what an item says."""
    what, _, where = item.partition(":")
    path = Path(where)
    if what == "make":
        path.touch()
    elif what == "await":
        while not path.exists():
            time.sleep(0.01)
    elif what == "die":
        os._exit(3)
    elif what == "fail":
        raise ValueError("no number")
    elif what == "wait":
        path.with_suffix(".part").write_text(str(os.getpid()))
        path.with_suffix(".part").rename(path)
        time.sleep(600)
    elif what == "where":
        masked = {signal.SIGINT, signal.SIGTERM} <= signal.pthread_sigmask(signal.SIG_BLOCK, ())
        return [os.getpid(), os.environ.get("OMP_NUM_THREADS"), masked]
    return item
