"""TOML files of users, read with typed errors."""

import tomllib
from pathlib import Path
from typing import Any, Final

from operators.errors import InputError
from storage.files import read

SIZE: Final = 2**20  # bytes


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
        InputError: if it is not TOML, or nests too many levels.
    """
    try:
        return tomllib.loads(text)
    except ValueError as error:  # with line and column
        raise InputError(where, f"is not valid TOML: {error}") from None
    except RecursionError:
        raise InputError(where, "is not valid TOML: it nests too many levels") from None
