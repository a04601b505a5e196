"""Single files: put in place whole, read with typed errors."""

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NoReturn, TypeAlias, cast

from operators.errors import InputError, os_error_reason
from storage import steps

MiB: Final = 1 << 20  # bytes
SCRATCH: Final = ".tmp"  # ends the name of a file that is not whole yet

CHECK: Final = "check"  # names the last entry of a JSON object, the sha256 of the others
Put: TypeAlias = Callable[[Path, bytes], None]  # writes a file so that it is found whole
_KINDS: Final = {".parquet": "part", ".wal": "segment"}  # what a step is said to be about; else its name


def put(path: Path, data: bytes) -> None:
    """Write a file so that whoever looks, even after a power cut, finds the old one or the new one whole.

    Raises:
        OSError: the old file is still there, or the new one already is.
    """
    place(path, data, durable=True)
    steps.reach(f"settle {kind(path)}")
    sync(path.parent)


def place(path: Path, data: bytes, *, durable: bool) -> None:
    """Write a file so that whoever looks finds the old one or the new one whole.

    Args:
        path: The file.
        data: All of it.
        durable: Whether its content, but not yet its name, outlives a power cut.

    Raises:
        OSError: the old file is still there.
    """
    scratch, what = path.with_name(path.name + SCRATCH), kind(path)
    try:
        steps.reach(f"write {what}")
        scratch.unlink(missing_ok=True)  # of one that was killed; or a link, which would be followed
        with scratch.open("xb") as file:
            file.write(data)
            if durable:
                file.flush()
                steps.reach(f"sync {what}")
                os.fsync(file.fileno())
        steps.reach(f"rename {what}")
        scratch.replace(path)
    except OSError:
        with suppress(OSError):
            scratch.unlink(missing_ok=True)
        raise


def kind(path: Path) -> str:
    """What a step says that it is about.

    >>> kind(Path("touch/part-000000.parquet")), kind(Path("session.json"))
    ('part', 'session')
    """
    return _KINDS.get(path.suffix, path.stem.lower())


def put_json(path: Path, content: Mapping[str, Any], put: Put = put) -> None:
    """Write a JSON file as `put` does."""
    put(path, json.dumps(content, indent=2, allow_nan=False).encode() + b"\n")


def put_checked(path: Path, content: Mapping[str, Any], put: Put = put) -> None:
    """Write a JSON file as `put` does, so that damage to it shows."""
    rest: dict[str, Any] = json.loads(json.dumps(dict(content), allow_nan=False))  # as it will be read
    rest.pop(CHECK, None)
    put_json(path, {**rest, CHECK: hash_json(rest)}, put)


def hash_json(content: Mapping[str, Any]) -> str:
    """The sha256, hex, of what a JSON object says, however it is laid out."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def make_folder(path: Path, *, new: bool = False) -> None:
    """Make a folder that outlives a power cut.

    Raises:
        FileExistsError: if there is one and it has to be `new`.
        OSError: if it cannot be made; a `new` one is not there.
    """
    path.mkdir(exist_ok=not new)
    try:
        sync(path.parent)
    except OSError:
        if new:
            path.rmdir()
        raise


def read(path: Path, limit: int = 1024 * MiB) -> bytes:
    """The bytes of a file.

    Raises:
        InputError: if it is missing, unreadable or larger than `limit` bytes.
    """
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            data = file.read(min(size, limit) + 1)
    except OSError as error:
        raise InputError(str(path), f"cannot be read: {os_error_reason(error)}") from error
    if len(data) > limit:
        raise InputError(
            str(path), f"is larger than {limit // MiB} MiB, the most that is read of such a file"
        )
    return data


def read_json(path: Path, limit: int = 64 * MiB) -> dict[str, Any]:
    """The object in a JSON file.

    Raises:
        InputError: if it cannot be read or holds something else.
    """
    try:
        content: object = json.loads(read(path, limit), parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        raise InputError(str(path), f"is not valid JSON: {error}; mend it or put a copy back") from error
    if not isinstance(content, dict):
        raise InputError(
            str(path), f"is not a JSON object, but a {type(content).__name__}; mend it or put a copy back"
        )
    return cast("dict[str, Any]", content)


def read_checked(path: Path) -> dict[str, Any]:
    """The object in a JSON file, which may lack the sha256 that `put_checked` adds; without that.

    Raises:
        InputError: if it cannot be read, holds something else or has another sha256.
    """
    content = read_json(path)
    rest = dict(content)
    last, check = rest.popitem() if rest else ("", None)
    if check == hash_json(rest):
        if last == CHECK:
            return rest  # else the name is what is damaged
    elif CHECK not in content:
        return content
    reason = (
        f"is damaged; or was changed by hand: then remove its last entry, {CHECK!r}; else put a copy back"
    )
    raise InputError(str(path), reason)


def sync(path: Path) -> None:
    """Make a file's content, or the names in a folder, durable."""
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is no number of JSON")
