"""Files of a dataset, as docs/reference/dataset.md describes them."""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from errno import ELOOP, ENOENT, ENOTDIR
from fnmatch import fnmatch
from functools import cached_property
from os.path import abspath
from pathlib import Path
from types import MappingProxyType
from typing import Final

from operators.batch import Batch, Episodes, Faults, Labelled, Motion, Slips, Touch, Truth, Zeroed, columns
from operators.column import Column
from operators.errors import InputError, ParameterError
from storage.files import SCRATCH, read_error

DATASET: Final = "dataset.json"
SESSIONS: Final = "sessions"
SESSION: Final = "session.json"
MANIFEST: Final = "MANIFEST.json"
JOURNAL: Final = "journal"
SEGMENTS: Final = "journal/*.wal"  # numbered files
DAMAGED: Final = "damaged"
LABELS: Final = "labels"
LABEL_FILES: Final = "labels/*.json"  # numbered files
FINGER_MAX: Final = 2**15 - 1  # largest number of a fingertip, which is stored in 16 bits

_LINK: Final = "is a link; a session must have none: replace it by the files"
_MISSING: Final = {ENOENT, ENOTDIR, ELOOP}  # errors of a path that has no file
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")


@dataclass(frozen=True)
class Table:
    """Table of a session, and the batches that it stores."""

    name: str
    kind: type[Batch]
    omits: frozenset[str] = frozenset()  # columns of the batch that it does not store
    finger: bool = True  # each row belongs to a fingertip; False: to all fingertips
    parted: bool = True  # a folder of parts; False: one file, written when the session closes

    @cached_property
    def columns(self) -> Mapping[str, Column]:
        """Stored columns of the batch, in order."""
        stored = {name: each for name, each in columns(self.kind).items() if name not in self.omits}
        return MappingProxyType(stored)

    @property
    def pattern(self) -> str:
        """Pattern of its files within the folder of the session, as `file_name` takes it."""
        return f"{self.name}/part-*.parquet" if self.parted else f"{self.name}.parquet"

    def has(self, path: str) -> bool:
        """Return true if the path of a listed file is one of the table."""
        return path.startswith((f"{self.name}/", f"{self.name}."))


TOUCH: Final = Table("touch", Touch)
MOTION: Final = Table("motion", Motion, finger=False)
SAMPLES: Final = Table("samples", Labelled, frozenset({"temperature", "pose", "matched"}))
SLIPS: Final = Table("slips", Slips, parted=False)
FAULTS: Final = Table("faults", Faults, parted=False)
EPISODES: Final = Table("episodes", Episodes, finger=False, parted=False)
TRUTH: Final = Table("truth", Truth)
TABLES: Final = (TOUCH, MOTION, SAMPLES, SLIPS, FAULTS, EPISODES, TRUTH)
TABLE_OF: Final[Mapping[type[Batch], Table]] = MappingProxyType(
    {table.kind: table for table in TABLES} | {Zeroed: TOUCH}
)


def table_of(path: str) -> Table | None:
    """Return the table of a file by its path within the folder of a session, None if it is no table's.

    >>> table_of("touch/part-000012.parquet") == TOUCH, table_of("touch/part-000012 (copy).parquet")
    (True, None)
    """
    found = (table for table in TABLES if table.has(path) and file_number(table.pattern, path) is not None)
    return next(found, None)


def file_name(pattern: str, number: int) -> str:
    """Return the path of a numbered file within the folder of a session.

    >>> file_name("touch/part-*.parquet", 12), file_name("slips.parquet", 0)
    ('touch/part-000012.parquet', 'slips.parquet')
    """
    return pattern.replace("*", f"{number:06d}")


def file_number(pattern: str, path: str) -> int | None:
    """Return the number of a file by its path, 0 if its pattern has none, None if it does not match."""
    match = re.fullmatch(re.escape(pattern).replace(r"\*", "([0-9]{6,12})"), path)
    number = int(match[1]) if match and match.groups() else 0
    return number if match and path == file_name(pattern, number) else None


def numbered_files(folder: Path, pattern: str) -> dict[int, Path]:
    """Return the files of a session that match a pattern by number, in order; others are ignored."""
    found = (
        (file_number(pattern, path.relative_to(folder).as_posix()), path)
        for path in files_of(folder, pattern)
    )
    return dict(sorted((number, path) for number, path in found if number is not None))


def session_folder(root: Path, session: str) -> Path:
    """Return the folder of a session, which is always inside the dataset.

    >>> session_folder(Path("recordings"), "2026-11-21").as_posix()
    'recordings/sessions/2026-11-21'

    Raises:
        ParameterError: if `session` is not the name of a file.
        InputError: if the folder, or that of all sessions, is a link.
    """
    if session in {"", ".", ".."} or not {"/", "\0"}.isdisjoint(session):
        raise ParameterError("Dataset", "session", session, "a file name")
    folder = root / SESSIONS / session
    for path in (folder.parent, folder):
        if path.is_symlink():
            raise InputError(str(path), _LINK)
    return folder


def new_session_folder(root: Path, session: str) -> Path:
    """Return the folder of a new session, whose name is a file name on every system.

    Raises:
        ParameterError: if it is not.
    """
    if not _NAME.fullmatch(session):
        must_be = "a file name of at most 128 letters, digits, '.', '_' or '-', first a letter or digit"
        raise ParameterError("Dataset", "session", session, must_be)
    return session_folder(root, session)


def session_folders(path: Path, *, lost: bool = False) -> list[Path]:
    """Return the folder of a session, or those of all sessions of a dataset, in the order of their names.

    Args:
        path: Folder of the dataset or session.
        lost: Also return the folders that have files, but no session.json.

    Raises:
        InputError: if the path is neither, or may not be read.
    """
    if may_exist(path / SESSION) or may_exist(path / MANIFEST):
        return [named(path)]
    sessions = path / SESSIONS
    if not path.is_dir() or sessions.is_file():
        path, kind = (sessions, "of the sessions") if path.is_dir() else (path, "of a dataset or session")
        reason = f"is a file, must be the folder {kind}" if path.exists() else "there is no such folder"
        raise InputError(str(path), reason)
    if not may_exist(path / DATASET) and not may_exist(sessions):
        raise InputError(str(path), f"is not a session (no {SESSION}) and not a dataset (no {DATASET})")
    found = files_of(path, f"{SESSIONS}/*")
    return [
        each
        for each in found
        if may_exist(each / SESSION) or (lost and any(file.suffix != SCRATCH for file in files_of(each, "*")))
    ]


def named(folder: Path) -> Path:
    """Return a path of a folder that ends in its name, which `.` and `..` do not.

    >>> named(Path("recordings")), named(Path("..")).name == Path.cwd().parent.name
    (PosixPath('recordings'), True)
    """
    return folder if folder.name not in {"", ".."} else Path(abspath(folder))  # noqa: PTH100 - keeps links


def may_exist(path: Path) -> bool:
    """Return true if a file exists, or its existence is unknown: reading it then reports the reason."""
    try:
        path.stat()
    except OSError as error:
        return error.errno not in _MISSING
    return True


def files_of(folder: Path, pattern: str) -> list[Path]:
    """Return the files that match a pattern such as ``touch/part-*.parquet``, sorted; [] without its folder.

    `Path.glob` ignores some errors, which would make existing files missing ones.

    Raises:
        InputError: if the folder may not be read.
        EndpointError: if the disk fails, or memory or file descriptors are short.
    """
    base, _, name = pattern.rpartition("/")
    try:
        names = [path.name for path in (folder / base).iterdir()]
    except OSError as error:
        if error.errno in _MISSING:
            return []
        raise read_error(folder / base, error) from error
    return [folder / base / each for each in sorted(names) if fnmatch(each, name)]


def check_links(folder: Path) -> None:
    """Check that the folder of a session contains no link, which could lead out of it or to another table.

    The folder itself may be a link, but not in a dataset.

    Raises:
        InputError: if it does, or may not be read.
    """
    own = named(folder).absolute()
    if own.parent.name == SESSIONS:
        session_folder(own.parent.parent, own.name)
    folders = [os.fspath(folder)]
    while folders:
        try:
            with os.scandir(folders.pop()) as entries:
                for entry in entries:
                    if entry.is_symlink():
                        raise InputError(entry.path, _LINK)
                    if entry.is_dir():
                        folders.append(entry.path)
        except FileNotFoundError:  # a recorder deletes its journal meanwhile
            continue
        except OSError as error:
            raise read_error(error.filename, error) from error
