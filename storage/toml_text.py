"""TOML files of users, read within limits, so that no file takes long or causes an unexpected error."""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from operators.errors import InputError
from storage.files import read

SIZE: Final = 2**20  # bytes
DEPTH: Final = 50  # levels of tables and lists
DIGITS: Final = 400  # of one number
_TEXT: Final = re.compile(r'"(?:[^"\\]|\\.)*"|\'[^\']*\'|#.*')  # in one line: strings and a comment


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises:
        InputError: if it cannot be read, is not text in UTF-8, or is larger than `SIZE`.
        EndpointError: if the disk fails, or memory or file descriptors are short.
    """
    try:
        return read(path, SIZE).decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(str(path), "is not text in UTF-8") from None


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """Return the tables of a TOML text; `where` names its file in errors.

    Raises:
        InputError: if it is not TOML, nests more than `DEPTH` levels, or has a number of more than `DIGITS`
            digits or 64 bits; the message has the line or the key.
    """
    level = 0
    for number, line in enumerate(text.splitlines(), 1):
        bare = _TEXT.sub("_", line)
        level += bare.count("[") + bare.count("{")
        parts = re.split(r"[][{},=]", bare)
        if max(level, *(part.count(".") for part in parts)) > DEPTH:
            raise InputError(f"{where}, line {number}", f"nests more than {DEPTH} levels")
        if max(map(len, re.findall(r"[0-9A-Fa-f_]+", bare)), default=0) > DIGITS:
            raise InputError(f"{where}, line {number}", f"has a number of more than {DIGITS} digits")
        level = max(0, level - bare.count("]") - bare.count("}"))
    try:
        table = tomllib.loads(text)
    except ValueError as error:  # with line and column
        raise InputError(where, f"is not valid TOML: {error}") from None
    if key := next(_too_large(table), None):
        raise InputError(where, f"{key[1:]} is a number of more than 64 bits")
    return table


def _too_large(value: object) -> Iterator[str]:
    """Yield the dotted keys of integers of more than 64 bits, each after a dot."""
    if isinstance(value, dict):
        yield from (f".{key}{rest}" for key, each in value.items() for rest in _too_large(each))
    elif isinstance(value, list):
        yield from (rest for each in value for rest in _too_large(each))
    elif isinstance(value, int) and not -(2**63) <= value < 2**63:
        yield ""
