"""Files that are written atomically and read with typed errors; locks and checks of folders."""

import fcntl
import hashlib
import json
import os
import time
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from errno import EACCES, EISDIR, ELOOP, ENAMETOOLONG, ENOENT, ENOTDIR, EPERM
from math import isfinite
from pathlib import Path
from shutil import disk_usage, rmtree
from stat import S_ISREG
from statistics import median
from tempfile import TemporaryFile
from typing import Any, Final, cast

from operators.errors import EndpointError, InputError, os_error_reason
from operators.ports import Finding

MiB: Final = 1 << 20  # bytes
SCRATCH: Final = ".tmp"  # suffix of a file that is not complete
LIMIT: Final = 512 * MiB  # bytes of a file that is read as a whole
JSON_LIMIT: Final = 8 * MiB  # bytes of a description
LIST_LIMIT: Final = 64 * MiB  # bytes of a list in JSON, such as a manifest: 30 h of three tables have 1 MiB
PARTIAL: Final = ".partial"  # suffix of an output that is not complete

CHECK: Final = "check"  # last key of a JSON object: the sha256 of the others
_OF_THE_PATH: Final = {EACCES, EISDIR, ELOOP, ENAMETOOLONG, ENOENT, ENOTDIR, EPERM}  # errors, not of the disk
NO_MEMORY: Final = "cannot be read: there is not enough memory"
_SYNCED_AT_ONCE: Final = 8  # files that are synced concurrently: a disk batches them
FREE_MIN: Final = 1e9  # bytes
SYNC_MAX: Final = 0.05  # s; on slower disks a power cut costs more rows than `storage.dataset.Dataset` states
_SYNCS: Final = 20
_FOLDER: Final = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
_BLOCK: Final = 4096  # bytes written before each fsync


def open_file(path: Path, *, follow: bool = False) -> int:
    """Open a regular file for reading and return its descriptor.

    Raises:
        InputError: if it is not a regular file, or is a link and `follow` is not set.
    """
    flags = os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK
    try:
        descriptor = os.open(path, flags if follow else flags | os.O_NOFOLLOW)
    except OSError as error:
        if error.errno == ELOOP and not follow:
            raise InputError(str(path), "is a link: replace it by the file") from error
        raise
    if not S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise InputError(str(path), "is not a regular file")
    return descriptor


def write_at(descriptor: int, data: bytes, offset: int) -> None:
    """Write bytes at `offset`."""
    left = memoryview(data)
    while left:
        written = os.pwrite(descriptor, left, offset)
        left, offset = left[written:], offset + written


def put(path: Path, data: bytes, *, durable: bool = True) -> None:
    """Write a file by renaming a temporary one, so that readers find its old or its new content.

    So does a power cut if it is `durable`; else a power cut may leave the file old, new, missing or with any
    content until it is synced.

    Raises:
        OSError: the file has its old or its new content.
    """
    scratch = path.with_name(path.name + SCRATCH)
    try:
        scratch.unlink(missing_ok=True)  # left by a killed process, or a link that must not be followed
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW
        descriptor = os.open(scratch, flags, 0o666)
        try:
            write_at(descriptor, data, 0)
            if durable:
                os.fsync(descriptor)
        finally:
            os.close(descriptor)
        scratch.replace(path)
    except OSError:
        with suppress(OSError):
            scratch.unlink(missing_ok=True)
        raise
    if durable:
        sync(path.parent)


@contextmanager
def write_errors(path: Path) -> Generator[None]:
    """Convert an error of the operating system in a block that writes to `path`.

    Raises:
        EndpointError: instead of an OSError.
    """
    try:
        yield
    except OSError as error:
        raise EndpointError(str(path), f"cannot be written: {os_error_reason(error)}") from error


def put_json(path: Path, content: Mapping[str, Any], *, durable: bool = True) -> None:
    """Write a JSON file as `put` does."""
    put(path, json.dumps(content, indent=2, allow_nan=False).encode() + b"\n", durable=durable)


def put_checked(path: Path, content: Mapping[str, Any], *, durable: bool = True) -> None:
    """Write a JSON file as `put` does, with a checksum as its last entry."""
    rest: dict[str, Any] = json.loads(json.dumps(dict(content), allow_nan=False))  # as it will be read
    rest.pop(CHECK, None)
    put_json(path, {**rest, CHECK: hash_json(rest)}, durable=durable)


def hash_json(content: Mapping[str, Any]) -> str:
    """Return the sha256 (hex) of a JSON object, independent of its formatting."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def make_folder(path: Path, *, new: bool = False, parents: bool = False, mode: int = 0o777) -> None:
    """Make a folder durably, with `parents` also the missing ones above it.

    Raises:
        FileExistsError: if it exists and must be `new`.
        OSError: if it cannot be made; a `new` one does not exist then.
    """
    if parents and not path.parent.exists():
        make_folder(path.parent, parents=True)
    path.mkdir(mode, exist_ok=not new)
    try:
        sync(path.parent)
    except OSError:
        if new:
            path.rmdir()
        raise


def read(path: Path, limit: int = LIMIT) -> bytes:
    """Return the content of a file.

    Raises:
        InputError: if there is no such file, it may not be read, or it is larger than `limit` bytes.
        EndpointError: if the disk fails, or memory or file descriptors are short.
    """
    try:
        descriptor = open_file(path, follow=True)
        try:
            size = os.fstat(descriptor).st_size
            data = os.pread(descriptor, size, 0) if size <= limit else b""
        finally:
            os.close(descriptor)
    except OSError as error:
        raise read_error(path, error) from error
    except MemoryError as error:
        raise EndpointError(str(path), NO_MEMORY) from error
    if size > limit:
        raise InputError(str(path), f"is larger than {limit // MiB} MiB, the limit for such a file")
    return data


def read_error(path: str | Path, error: OSError) -> InputError | EndpointError:
    """Return the error for a file that cannot be read: an InputError only if its path is the reason."""
    kind = InputError if error.errno in _OF_THE_PATH else EndpointError
    return kind(str(path), f"cannot be read: {os_error_reason(error)}")


def read_json(path: Path, limit: int = JSON_LIMIT) -> dict[str, Any]:
    """Return the object in a JSON file.

    Raises:
        InputError: if there is no such file, it may not be read, it is not a JSON object, or it is larger
            than `limit` bytes.
        EndpointError: if the disk fails, or memory or file descriptors are short.
    """
    data = read(path, limit)
    try:
        content: object = json.loads(data, parse_constant=_number, parse_float=_number)
    except MemoryError as error:
        raise EndpointError(str(path), NO_MEMORY) from error
    except (ValueError, RecursionError) as error:
        raise InputError(str(path), f"is not valid JSON: {error}; correct it or restore a copy") from error
    if not isinstance(content, dict):
        reason = f"is not a JSON object, but a {type(content).__name__}; correct it or restore a copy"
        raise InputError(str(path), reason)
    return cast("dict[str, Any]", content)


def read_checked(path: Path, limit: int = JSON_LIMIT) -> dict[str, Any]:
    """Return the object in a JSON file without its checksum, which it may lack.

    Raises:
        InputError: if the file cannot be read, is not a JSON object, or does not match its checksum.
    """
    content = read_json(path, limit)
    rest = dict(content)
    last, check = rest.popitem() if rest else ("", None)
    if check == hash_json(rest):
        if last == CHECK:
            return rest  # else the key itself is damaged
    elif CHECK not in content:
        return content
    reason = f"is damaged: restore a copy; if it was edited by hand, remove its last entry, {CHECK!r}"
    raise InputError(str(path), reason)


def sync(path: Path) -> None:
    """Make the content of a file, or the names in a folder, durable."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_tree(path: Path) -> None:
    """Make a file durable; or all files in a folder, then all names in it."""
    paths = [path, *path.rglob("*")]
    with ThreadPoolExecutor(_SYNCED_AT_ONCE) as pool:
        list(pool.map(sync, (each for each in paths if not each.is_dir())))
        list(pool.map(sync, (each for each in paths if each.is_dir())))


@contextmanager
def partial_output(path: Path, make: Callable[..., None] = Path.mkdir) -> Generator[Path]:
    """Make a folder `<path>.partial`; sync and rename it to `path` if the block succeeds, else delete it.

    If `make` is `Path.touch`, it is a file.

    Raises:
        EndpointError: if `path` is a file or a folder with files, `<path>.partial` exists, or it cannot be
            written.
    """
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise EndpointError(str(path), "exists already: give another name, or remove it")
    if path.is_symlink() or not path.name:  # a folder can be renamed neither to a link nor to `.`
        path = path.resolve()
    scratch = path.with_name(path.name + PARTIAL)
    with write_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            make(scratch, exist_ok=False)
        except FileExistsError:
            reason = "is being written by another process, or was left by one that was killed: then remove it"
            raise EndpointError(str(scratch), reason) from None
        try:
            yield scratch
            sync_tree(scratch)
            scratch.rename(path)
            sync(path.parent)
        except BaseException:
            rmtree(scratch, ignore_errors=True)
            with suppress(OSError):
                scratch.unlink(missing_ok=True)
            raise


def lock(folder: Path) -> int | None:
    """Lock a folder; return the descriptor that holds the lock until it is closed, None if another has it."""
    return _flock(os.open(folder, _FOLDER))


@contextmanager
def exclusive(folder: Path) -> Generator[None]:
    """Wait for the lock of a folder, and hold it."""
    held = _flock(os.open(folder, _FOLDER), fcntl.LOCK_EX)
    assert held is not None, "waited for it"
    try:
        yield
    finally:
        os.close(held)


def lock_file(path: Path) -> int | None:
    """Lock a file through ``<path>.lock``, which is never deleted; the file may be missing or be replaced.

    Return a descriptor or None as `lock` does.
    """
    return _flock(os.open(f"{path}.lock", os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600))


def locked(folder: Path) -> bool:
    """Return True if a process holds the lock of a folder; False also if the folder cannot be opened."""
    try:
        descriptor = _flock(os.open(folder, _FOLDER), fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return False
    if descriptor is not None:
        os.close(descriptor)
    return descriptor is None


def check_disk(folder: Path) -> list[Finding]:
    """Return what a run that writes below `folder` would find; `folder` need not exist.

    Raises:
        EndpointError: if it cannot be written.
    """
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    with write_errors(folder):
        free, times = disk_usage(existing).free, _sync_times(existing)
    space = f"{free / 1e9:,.1f} GB free"
    sync = f"fsync {median(times) * 1e3:.1f} ms, longest of {_SYNCS} {max(times) * 1e3:.1f} ms"
    found = [Finding(str(folder), space), Finding(str(folder), sync)]
    if free < FREE_MIN:
        found[0] = Finding(str(folder), f"{space}: free some space, or use another disk", "bad")
    if median(times) > SYNC_MAX:
        slow = f"{sync}: use a faster disk; a power cut may cost more than 0.3 s"
        found[1] = Finding(str(folder), slow, "bad")
    return found


def _flock(descriptor: int, kind: int = fcntl.LOCK_EX | fcntl.LOCK_NB) -> int | None:
    try:
        fcntl.flock(descriptor, kind)
    except OSError as error:
        os.close(descriptor)
        if isinstance(error, BlockingIOError):
            return None
        raise
    return descriptor


def _number(text: str) -> float:
    """Return a finite number; Python also reads NaN, Infinity and 1e400."""
    if isfinite(number := float(text)):
        return number
    raise ValueError(f"{text} is not a JSON number")


def _sync_times(folder: Path) -> list[float]:
    """Return the durations (s) of fsyncs, each after a block was written to a temporary file."""
    times = list[float]()
    with TemporaryFile(dir=folder) as file:
        for _ in range(_SYNCS):
            os.write(file.fileno(), bytes(_BLOCK))
            start = time.perf_counter()
            os.fsync(file.fileno())
            times.append(time.perf_counter() - start)
    return times
