"""Whether a dataset is all there: every file against the manifests, every page against its checksum."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from operators.errors import InputError
from storage.description import read_dataset
from storage.findings import Finding, Weight, heaviest
from storage.layout import (
    DATASET,
    SESSION,
    SESSIONS,
    headless,
    headless_names,
    inside,
    may_be,
    session_names,
)
from storage.manifest import Part
from storage.session_check import SessionCheck

GOOD: Final = 0  # exit codes
LOST: Final = 1
LOSSY: Final = 3

Progress = Callable[[int, int, str], object]  # files done, of how many, session


@dataclass(frozen=True)
class Checked:
    """A file that a session's manifest lists."""

    session: str
    part: Part
    whole: bool  # False: it is gone or damaged


@dataclass(frozen=True)
class Verified:
    """What a check of a dataset found."""

    sessions: int
    files: int  # Parquet files that were read
    rows: int  # in them
    findings: tuple[Finding, ...]
    parts: tuple[Checked, ...] = ()
    names: tuple[str, ...] = ()  # of all sessions

    @property
    def code(self) -> int:
        """0: all there; 3: something was repaired, or is missing and known to be; 1: something was lost."""
        return GOOD if self.worst == "note" else LOST if self.worst == "lost" else LOSSY

    @property
    def worst(self) -> Weight:
        """The weight of the worst finding; a note if there is none."""
        return heaviest(self.findings)


def verify(path: str | Path, progress: Progress = lambda _done, _of, _session: None) -> Verified:
    """Read all of a dataset, or of one session, and compare; nothing is changed.

    A session that is being recorded is checked as far as it is committed.

    Args:
        path: The dataset's folder, or the session's.
        progress: Told how far the check is.

    Raises:
        InputError: if there is neither, or it may not be looked into.
    """
    root = Path(path)
    findings = list[Finding]()
    if may_be(root / SESSION) or headless(root):
        folders = [root]
    else:
        if not root.is_dir():
            reason = "is a file, must be the folder of a dataset or session"
            raise InputError(str(root), reason if root.exists() else "there is no such folder")
        try:
            read_dataset(root)
        except InputError as error:
            findings.append(Finding("", "lost", str(error)))
        names = sorted([*session_names(root), *headless_names(root)])
        folders = [inside(root, root / SESSIONS / name) for name in names]
        if findings and not folders:
            reason = f"is no session, which has a {SESSION}, and no dataset, which has a {DATASET}"
            raise InputError(str(root), reason)
        if not folders:
            findings.append(Finding("", "lossy", "holds no session: none was recorded, or they are gone"))
    checks = [SessionCheck(folder) for folder in folders]
    done, of = 0, sum(len(check.listed) for check in checks)
    for check in checks:
        for _ in check.carry_out():
            progress(done := done + 1, of, check.name)
        findings += check.findings
    read = [check.read for check in checks]
    return Verified(
        len(checks),
        sum(map(len, read)),
        sum(sum(each.values()) for each in read),
        tuple(findings),
        tuple(
            Checked(check.name, part, path in check.read)
            for check in checks
            for path, part in check.listed.items()
        ),
        tuple(check.name for check in checks),
    )
