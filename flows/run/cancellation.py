"""Code of sources and sinks that may not end the task that runs it: by a cancellation, or by `sys.exit`."""

import asyncio
from collections.abc import Callable, Generator
from contextlib import contextmanager

from operators.errors import SlipflowError


@contextmanager
def contained(failure: Callable[[str], SlipflowError]) -> Generator[None]:
    """Pass on the cancellation of this task only; that of a task that the code awaits is a failure.

    Args:
        failure: Returns the error of a source or sink for a reason.

    Raises:
        RuntimeError: if the code raises CancelledError although this task was not cancelled.
        SlipflowError: if the code calls `sys.exit`.
    """
    try:
        yield
    except asyncio.CancelledError as error:
        task = asyncio.current_task()
        if task is None or task.cancelling():
            raise
        raise RuntimeError("a task that it awaited was cancelled") from error
    except SystemExit as error:
        raise failure(exit_reason(error)) from error


def exit_reason(error: SystemExit) -> str:
    """Return the reason of a failure by `sys.exit`.

    >>> exit_reason(SystemExit(2))
    'calls sys.exit(2)'
    """
    return f"calls sys.exit({'' if error.code is None else repr(error.code)})"
