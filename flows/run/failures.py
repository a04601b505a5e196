"""Failures of sources and sinks: which end a run, and their reasons as text."""

import asyncio
from collections.abc import Generator
from contextlib import contextmanager
from typing import Final

from operators.errors import SlipflowError, os_error_reason

MISTAKES: Final = (  # of the code of a source or sink: a retry would not help
    ArithmeticError,
    AssertionError,
    AttributeError,
    ImportError,
    LookupError,
    NameError,
    TypeError,
    ValueError,
)


def reason_of(error: Exception) -> str:
    """Return an error's message, with its type unless slipflow or the operating system raised it.

    >>> reason_of(OSError("Connection reset")), reason_of(KeyError("x"))
    ('Connection reset', "KeyError: 'x'")
    """
    if isinstance(error, OSError):
        of_device = error.filename is None or str(error.filename).startswith("/dev/")
        reason = os_error_reason(error, of_device=of_device)
        return reason if error.filename is None else f"{error.filename}: {reason}"
    text = str(error)
    return text if isinstance(error, SlipflowError) else f"{type(error).__name__}: {text}".removesuffix(": ")


@contextmanager
def contained() -> Generator[None]:
    """Pass on the cancellation of this task only; that of a task that the code awaits is a failure.

    Raises:
        RuntimeError: if the code raises CancelledError although this task was not cancelled.
    """
    try:
        yield
    except asyncio.CancelledError as error:
        task = asyncio.current_task()
        if task is None or task.cancelling():
            raise
        raise RuntimeError("a task that it awaited was cancelled") from error
