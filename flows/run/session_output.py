"""Sessions that appear in a dataset as a whole, so that the task that writes one can be repeated."""

import os
from collections.abc import Generator, Iterable
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import rmtree
from typing import Final
from uuid import uuid4

from operators.errors import InputError
from storage.description import describe_dataset
from storage.files import make_folder, sync, sync_tree, write_errors
from storage.layout import MANIFEST, SESSIONS, session_folder

_PARTIAL: Final = ".partial"  # folder in a dataset: sessions that are being written


@contextmanager
def new_session(root: Path, session: str) -> Generator[Path]:
    """Yield a temporary dataset; if the block succeeds, move its session durably to the dataset `root`.

    `root` is created if absent. If it has a session with the same data, nothing changes.

    Raises:
        InputError: if it has another session of that name, or has files but is not a valid dataset.
        EndpointError: if it cannot be written to.
    """
    scratch, target = root / _PARTIAL / session / uuid4().hex, session_folder(root, session)
    with write_errors(root):
        make_folder(root, parents=True)
        describe_dataset(root)
        make_folder(root / SESSIONS)
        scratch.parent.mkdir(parents=True, exist_ok=True)
    try:
        yield scratch
        complete = session_folder(scratch, session)
        with write_errors(root):
            if not target.exists():
                sync_tree(complete)
                os.rename(complete, target)  # noqa: PTH104 - unlike Path.replace, never replaces files
                sync(root / SESSIONS)
            elif (target / MANIFEST).read_bytes() != (complete / MANIFEST).read_bytes():
                raise InputError(str(target), "another session has this name: write to another dataset")
    finally:
        rmtree(scratch, ignore_errors=True)


def remove_partial(root: Path, sessions: Iterable[str]) -> None:
    """Remove what killed tasks have left."""
    for session in sessions:
        rmtree(root / _PARTIAL / session, ignore_errors=True)
    with suppress(OSError):
        (root / _PARTIAL).rmdir()
