"""What is written under another name and gets its own when it is whole."""

import os
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import rmtree
from typing import BinaryIO

from operators.errors import EndpointError, os_error_reason
from storage.files import sync

SUFFIX = ".partial"


@contextmanager
def partial_file(path: Path) -> Generator[BinaryIO]:
    """A new file that stands beside `path` until the block ends well, and goes if it does not.

    Raises:
        EndpointError: if there is a file of either name, or it cannot be written.
    """
    if path.exists():
        raise EndpointError(str(path), "is there already; give another name, or remove it")
    scratch = path.with_name(path.name + SUFFIX)
    with _reporting(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        file = _claimed(scratch)
        try:
            with file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            _place(scratch, path)
        except BaseException:
            with suppress(OSError):
                scratch.unlink(missing_ok=True)
            raise


@contextmanager
def partial_folder(path: Path) -> Generator[Path]:
    """The same for a folder, which may be there if it is empty; what is in it is synced, too.

    Raises:
        EndpointError: if there is a file of that name, or anything in it or under the name it is given at
            first, or it cannot be written.
    """
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise EndpointError(str(path), "must be a new or empty folder")
    scratch = path.with_name(path.name + SUFFIX)
    with _reporting(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            scratch.mkdir()
        except FileExistsError:
            raise _left(scratch) from None
        try:
            yield scratch
            for each in scratch.rglob("*"):
                sync(each)
            _place(scratch, path)
        except BaseException:
            rmtree(scratch, ignore_errors=True)
            raise


def _claimed(scratch: Path) -> BinaryIO:
    try:
        return scratch.open("xb")
    except FileExistsError:
        raise _left(scratch) from None


def _left(scratch: Path) -> EndpointError:
    reason = "is being written, or what is left of a run that was killed; then remove it"
    return EndpointError(str(scratch), reason)


def _place(scratch: Path, path: Path) -> None:
    scratch.rename(path)
    sync(path.parent)


@contextmanager
def _reporting(path: Path) -> Generator[None]:
    try:
        yield
    except OSError as error:
        raise EndpointError(str(path), f"cannot be written: {os_error_reason(error)}") from error
