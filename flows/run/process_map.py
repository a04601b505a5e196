"""Applying a function to many items in several processes; one process that dies ends it all.

`flows.run.processes` goes on where a process dies, and can be watched and stopped; this is all that
simulating and judging need.
"""

import os
import signal
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import TypeVar

from operators.errors import SlipflowError

Item = TypeVar("Item")
Result = TypeVar("Result")


def process_map(work: Callable[[Item], Result], items: Sequence[Item], jobs: int) -> Generator[Result]:
    """The result of each item, in order; close the generator to end the processes early.

    Args:
        work: Is pickled, as are items and results. What it raises is raised here.
        items: What it is applied to.
        jobs: Processes, which end with this one; 1: none but this one.

    Raises:
        SlipflowError: if a process ended early.
    """
    if jobs == 1:
        yield from map(work, items)
        return
    try:
        with ProcessPoolExecutor(jobs, get_context("spawn"), initializer=_follow_parent) as pool:
            yield from pool.map(work, items)
    except BrokenProcessPool as error:
        raise SlipflowError(
            f"one of {jobs} processes ended early, perhaps killed for memory; use fewer jobs"
        ) from error


def _follow_parent() -> None:
    """Leave Ctrl-C to the parent, and end when it ends, even killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    assert parent, "runs in a worker"

    def follow() -> None:
        parent.join()
        os._exit(1)

    Thread(target=follow, daemon=True).start()
