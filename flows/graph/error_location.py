"""Locations of errors in the files of users."""

import inspect
import traceback
from pathlib import Path


def location(part: object, error: BaseException) -> str:
    """Return the line of a part's file at which an error was raised, such as `` (own.py:23)``."""
    try:
        file = Path(inspect.getfile(type(part)))
    except (TypeError, OSError):
        return ""
    line = line_in(file, error)
    return "" if line is None else f" ({file.name}:{line})"


def line_in(file: Path, error: BaseException) -> int | None:
    """Return the last line of a file in an error's traceback; None: the error did not pass through it."""
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if Path(frame.filename).resolve() == file.resolve()]
    return lines[-1] if lines else None
