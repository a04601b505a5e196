"""Libraries kept to one thread: what one core costs, and no fight for it between processes."""

import sys
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from importlib.util import find_spec
from typing import Any


@contextmanager
def one_thread() -> Generator[None]:
    """Let those that would use more use one: torch, if it runs, and what scikit-learn and numpy stand on."""
    with ExitStack() as stack:
        if torch := sys.modules.get("torch"):
            stack.callback(torch.set_num_threads, torch.get_num_threads())
            torch.set_num_threads(1)
        if find_spec("sklearn") and find_spec("threadpoolctl"):  # they come together
            import_module("sklearn")  # its threads cannot be limited before they are there
            pools: Any = import_module("threadpoolctl")
            stack.enter_context(pools.threadpool_limits(1))
        yield
