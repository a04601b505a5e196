"""Keeping numerical libraries to one thread: to time one core, or to run one process on each."""

import sys
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from importlib.util import find_spec
from typing import Any


@contextmanager
def one_thread() -> Generator[None]:
    """Limit torch, if it is imported, and the libraries below scikit-learn and numpy, within a block."""
    with ExitStack() as stack:
        if torch := sys.modules.get("torch"):
            stack.callback(torch.set_num_threads, torch.get_num_threads())
            torch.set_num_threads(1)
        if find_spec("sklearn") and find_spec("threadpoolctl"):  # they come together
            import_module("sklearn")  # its threads cannot be limited before they are there
            pools: Any = import_module("threadpoolctl")
            stack.enter_context(pools.threadpool_limits(1))
        yield
