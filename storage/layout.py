"""Files of a dataset.

.. code-block:: text

    dataset.json
    sessions/<session>/session.json                 description of the recording; written first
    sessions/<session>/touch/part-000000.parquet    rows as received; likewise motion
    sessions/<session>/samples/part-000000.parquet  derived rows, which can be rebuilt
    sessions/<session>/slips.parquet                slip events; likewise faults.parquet
    sessions/<session>/clocks.parquet               offset and drift of a device's clock
    sessions/<session>/episodes.parquet             motions of the arm
    sessions/<session>/truth/part-000000.parquet    state of a simulated contact at each touch row
    sessions/<session>/MANIFEST.json                the files above with rows, time range and sha256
    sessions/<session>/journal/000000.wal           rows that are in no file above yet: while recording, or
                                                    after a kill; see storage.journal
    sessions/<session>/labels/000001.json           labels given by hand, one file per version; see
                                                    storage.hand_labels
    sessions/<session>/damaged/                     files that a recovery moved away
"""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from errno import ELOOP, ENOENT, ENOTDIR
from fnmatch import fnmatch
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Final

from operators.batch import (
    Batch,
    Clocks,
    Column,
    Episodes,
    Faults,
    Labelled,
    Motion,
    Slips,
    Touch,
    Truth,
    Zeroed,
    columns,
)
from operators.errors import InputError, ParameterError
from storage.files import SCRATCH, read_error

DATASET: Final = "dataset.json"
SESSIONS: Final = "sessions"
SESSION: Final = "session.json"
MANIFEST: Final = "MANIFEST.json"
JOURNAL: Final = "journal"
DAMAGED: Final = "damaged"
LABELS: Final = "labels"
FINGER_MAX: Final = 2**15 - 1  # largest number of a fingertip, which is stored in 16 bits

_LINK: Final = "is a link; a session must have none: replace it by the files"
_MISSING: Final = {ENOENT, ENOTDIR, ELOOP}  # errors of a path that has no file
_DIGITS: Final = 12  # of the number of a file at most
_SEGMENT: Final = re.compile(rf"[0-9]{{6,{_DIGITS}}}\.wal")
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
        """Glob pattern of its files."""
        return f"{self.name}/part-*.parquet" if self.parted else self.file(0)

    def has(self, path: str) -> bool:
        """Return true if a path within the folder of the session belongs to the table."""
        return path.startswith((f"{self.name}/", f"{self.name}."))

    def file(self, number: int) -> str:
        """Return the path of a file within the folder of the session.

        >>> SAMPLES.file(2), SLIPS.file(0)
        ('samples/part-000002.parquet', 'slips.parquet')
        """
        return f"{self.name}/part-{number:06d}.parquet" if self.parted else f"{self.name}.parquet"


TOUCH: Final = Table("touch", Touch)
MOTION: Final = Table("motion", Motion, finger=False)
SAMPLES: Final = Table("samples", Labelled, frozenset({"temperature", "pose", "matched"}))
SLIPS: Final = Table("slips", Slips, parted=False)
FAULTS: Final = Table("faults", Faults, parted=False)
CLOCKS: Final = Table("clocks", Clocks, finger=False, parted=False)
EPISODES: Final = Table("episodes", Episodes, finger=False, parted=False)
TRUTH: Final = Table("truth", Truth)
TABLES: Final = (TOUCH, MOTION, SAMPLES, SLIPS, FAULTS, CLOCKS, EPISODES, TRUTH)
TABLE_OF: Final[Mapping[type[Batch], Table]] = MappingProxyType(
    {table.kind: table for table in TABLES} | {Zeroed: TOUCH}
)


def is_table_file(path: str) -> bool:
    """Return true if a path within the folder of a session is that of a table's file.

    >>> is_table_file("touch/part-000012.parquet"), is_table_file("touch/part-000012 (copy).parquet")
    (True, False)
    """
    return any(table.has(path) and path == table.file(part_number(path)) for table in TABLES)


def part_number(path: str) -> int:
    """Return the number of a table's file by its path, 0 for a single-file table or more than 12 digits.

    >>> part_number("touch/part-000012.parquet"), part_number("slips.parquet")
    (12, 0)
    """
    stem = path.rpartition("-")[2].partition(".")[0]
    return int(stem) if stem.isdecimal() and len(stem) <= _DIGITS else 0


def table_files(folder: Path, table: Table) -> list[str]:
    """Return the paths of a table's files within the folder of a session, in order; others are ignored.

    Raises:
        SlipflowError: as `files_of`.
    """
    base = f"{table.name}/" if table.parted else ""
    found = (base + path.name for path in files_of(folder, table.pattern))
    return sorted((path for path in found if path == table.file(part_number(path))), key=part_number)


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
        InputError: as `session_folder`.
    """
    if not _NAME.fullmatch(session):
        must_be = "a file name of at most 128 letters, digits, '.', '_' or '-', first a letter or digit"
        raise ParameterError("Dataset", "session", session, must_be)
    return session_folder(root, session)


def session_names(root: Path) -> list[str]:
    """Return the names of the sessions of a dataset, sorted; include folders without read permission.

    Raises:
        SlipflowError: as `files_of`, or if the folder of the sessions is a file.
    """
    return [path.name for path in _session_folders(root) if may_exist(path / SESSION)]


def session_folders(path: Path) -> list[Path]:
    """Return the folder of a session, or those of all sessions of a dataset, sorted.

    A folder without session.json counts if it has any other file: then session.json is lost.

    Raises:
        InputError: if the path is neither, or may not be read.
        EndpointError: if the disk fails, or memory or file descriptors are short.
    """
    if may_exist(path / SESSION) or may_exist(path / MANIFEST):
        return [path]
    if not path.is_dir():
        reason = "is a file, must be the folder of a dataset or session"
        raise InputError(str(path), reason if path.exists() else "there is no such folder")
    if not may_exist(path / DATASET) and not may_exist(path / SESSIONS):
        raise InputError(str(path), f"is not a session (no {SESSION}) and not a dataset (no {DATASET})")
    found = _session_folders(path)
    return [each for each in found if may_exist(each / SESSION) or (each.is_dir() and _has_files(each))]


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


def _session_folders(root: Path) -> list[Path]:
    if (root / SESSIONS).is_file():
        raise InputError(str(root / SESSIONS), "is a file, must be the folder of the sessions")
    return files_of(root, f"{SESSIONS}/*")


def _has_files(folder: Path) -> bool:
    """Return true if a folder has more than files that a killed process did not complete."""
    return any(path.suffix != SCRATCH for path in files_of(folder, "*"))


def segments(folder: Path) -> dict[int, Path]:
    """Return the segments of a journal by number, in order; none if there is no journal.

    Raises:
        SlipflowError: as `files_of`.
    """
    found = (path for path in files_of(folder, f"{JOURNAL}/*.wal") if _SEGMENT.fullmatch(path.name))
    return dict(sorted((int(path.stem), path) for path in found))


def segment_file(number: int) -> str:
    """Return the path of a segment within the folder of the session, such as ``journal/000007.wal``."""
    return f"{JOURNAL}/{number:06d}.wal"


def check_links(folder: Path) -> None:
    """Check that the folder of a session contains no link, which could lead out of it or to another table.

    The folder itself may be a link, but not in a dataset.

    Raises:
        InputError: if it does, or may not be read.
        EndpointError: if the disk fails, or memory or file descriptors are short.
    """
    sessions = folder.absolute().parent
    if sessions.name == SESSIONS:
        session_folder(sessions.parent, folder.name)
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
