"""Failures of sources and sinks, and log events of a run, each with a line of text and structured data."""

import asyncio
import logging
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

from operators.errors import SlipflowError, os_error_reason
from operators.ports import Json

log = logging.getLogger("slipflow")


def event(name: str, **about: Json) -> dict[str, Any]:
    """Return the structured data of a log record, for `extra`; `flows.cli.terminal` writes it as JSON.

    >>> event("source_failed", source="touch")
    {'event': 'source_failed', 'about': {'source': 'touch'}}
    """
    return {"event": name, "about": about}


def reason_of(error: Exception) -> str:
    """Return an error's message, with its type unless slipflow or the operating system raised it.

    >>> reason_of(OSError("Connection reset")), reason_of(KeyError("x"))
    ('Connection reset', "KeyError: 'x'")
    """
    if isinstance(error, OSError):
        reason = os_error_reason(error)
        return reason if error.filename is None else f"{error.filename}: {reason}"
    text = str(error)
    return text if isinstance(error, SlipflowError) else f"{type(error).__name__}: {text}".removesuffix(": ")


def warn(name: str, text: str, **about: Json) -> None:
    """Log an event of a run with a line of text."""
    log.warning("%s", text, extra=event(name, **about))


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
