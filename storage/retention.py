"""Deletion of old sessions of a dataset, and marks of those that were exported."""

import os
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree
from typing import Final

from operators.errors import EndpointError, InputError, os_error_reason
from storage import files
from storage.description import read_dataset, read_session
from storage.layout import (
    EXPORTED,
    JOURNAL,
    LABELS,
    SESSION,
    check_links,
    files_of,
    may_exist,
    session_folder,
    session_names,
)
from storage.lock import lock
from storage.manifest import read_manifest

_DELETED: Final = ".deleted"  # folder of sessions whose deletion is not finished
_BEING_RECORDED: Final = "is being recorded"


@dataclass(frozen=True, slots=True)
class Pruned:
    """A session that a limit applies to."""

    session: str
    size: int  # bytes
    age: int  # ns since it was written
    reason: str  # limit that applies to it
    kept: str = ""  # reason why it is kept; empty: it is deleted


def prune(
    root: str | Path,
    *,
    now: int,
    older_than: int | None = None,
    larger_than: int | None = None,
    keep_unexported: bool = False,
    dry_run: bool = False,
) -> list[Pruned]:
    """Delete sessions, oldest first, until the limits hold.

    The age counts from the last change of session.json, at the end of the recording or import. Sessions are
    kept that are being recorded, need a recovery, cannot be read, or contain a link.

    Args:
        root: Folder of the dataset.
        now: Time, ns since 1970 UTC.
        older_than: Delete sessions of a greater age, ns.
        larger_than: Delete the oldest sessions while the files of all sessions have more bytes.
        keep_unexported: Keep sessions without a mark of an export after their last change.
        dry_run: Return what would be deleted, and change nothing.

    Returns:
        Each session that a limit applies to, oldest first.

    Raises:
        InputError: if `root` is not a dataset, or has a link that leads out of it.
        EndpointError: if a session cannot be deleted.
    """
    root = Path(root)
    read_dataset(root)
    if (root / _DELETED).is_symlink():
        raise InputError(str(root / _DELETED), "is a link, must be a folder: delete the link")
    if not dry_run:
        rmtree(root / _DELETED, ignore_errors=True)  # of a prune that was killed
    folders = [session_folder(root, name) for name in session_names(root)]
    sizes = {folder: _size(folder) for folder in folders}
    total, found = sum(sizes.values()), list[Pruned]()
    for written, folder in sorted((_changed(folder / SESSION), folder) for folder in folders):
        age, size = now - written, sizes[folder]
        if older_than is not None and age > older_than:
            reason = "its age"
        elif larger_than is not None and total > larger_than:
            reason = "the size of the dataset"
        else:
            continue
        with _unlocked(folder) as free:
            kept = _obstacle(folder, keep_unexported=keep_unexported) if free else _BEING_RECORDED
            if not kept:
                total -= size
                if not dry_run:
                    _delete(root, folder)
        found.append(Pruned(folder.name, size, age, reason, kept))
    return found


def mark_exported(folder: Path, to: str, out: Path, began: int) -> None:
    """Mark a session as exported.

    Args:
        folder: Folder of the session.
        to: Format of the export.
        out: Path of the export.
        began: Time at which the export began, ns since 1970 UTC: labels written since then are not in it.

    Raises:
        OSError: if the mark cannot be written.
    """
    files.put_json(folder / EXPORTED, {"to": to, "out": str(out.absolute())})
    os.utime(folder / EXPORTED, ns=(began, began))


def is_exported(folder: Path) -> bool:
    """Return True if an export of a session began after its last change or label."""
    if not may_exist(folder / EXPORTED):
        return False
    changed = [folder / SESSION, *files_of(folder, f"{LABELS}/*.json")]
    return _changed(folder / EXPORTED) >= max(map(_changed, changed))


def _obstacle(folder: Path, *, keep_unexported: bool) -> str:
    """Return the reason to keep a session that is not being recorded, empty if there is none."""
    try:
        check_links(folder)
        about = read_session(folder)
        read_manifest(folder)
        if may_exist(folder / JOURNAL) or not {"end_ns", "recovered"} & about.keys():
            return "needs a recovery: run slipflow recover"
        return "is not exported" if keep_unexported and not is_exported(folder) else ""
    except InputError as error:
        return str(error)


@contextmanager
def _unlocked(folder: Path) -> Generator[bool]:
    """Hold the lock of a session; False if a recorder has it, or the folder cannot be opened."""
    try:
        held = lock(folder)
    except OSError:
        held = None
    try:
        yield held is not None
    finally:
        if held is not None:
            os.close(held)


def _delete(root: Path, folder: Path) -> None:
    """Move a session out of the dataset at once, then delete its files.

    Raises:
        EndpointError: if it cannot be moved or deleted.
    """
    try:
        files.make_folder(root / _DELETED)
        folder.rename(root / _DELETED / folder.name)
        files.sync(folder.parent)
        rmtree(root / _DELETED)
    except OSError as error:
        raise EndpointError(str(folder), f"cannot be deleted: {os_error_reason(error)}") from error


def _size(folder: Path) -> int:
    """Return the bytes of the files of a session; a recorder may delete some meanwhile."""
    total = 0
    for base, _, names in os.walk(folder):
        for name in names:
            try:
                total += os.lstat(os.path.join(base, name)).st_size  # noqa: PTH118 - faster than Path
            except FileNotFoundError:
                continue
    return total


def _changed(path: Path) -> int:
    """Return the time of the last change of a file, ns since 1970 UTC."""
    try:
        return path.stat().st_mtime_ns
    except OSError as error:
        raise files.read_error(path, error) from error
