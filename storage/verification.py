"""Whether a dataset is all there: every file against the manifests, every page against its checksum."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, cast

from operators.errors import InputError
from operators.ports import Description
from storage import files
from storage.description import read_dataset, read_session
from storage.layout import (
    DAMAGED,
    EPISODES,
    JOURNAL,
    MANIFEST,
    SAMPLES,
    SESSION,
    TABLES,
    Table,
    inside,
    segments,
    session_folder,
    session_names,
)
from storage.lock import locked
from storage.manifest import Part, read_manifest

GOOD: Final = 0  # exit codes
LOST: Final = 1
LOSSY: Final = 3

Weight = Literal["note", "lossy", "lost"]
Progress = Callable[[int, int, str], object]  # files done, of how many, session


@dataclass(frozen=True)
class Finding:
    """Something about a session that is not as it should be; a mere note says nothing against it."""

    session: str
    weight: Weight
    text: str


@dataclass(frozen=True)
class Verified:
    """What a check of a dataset found."""

    sessions: int
    files: int  # Parquet files that were read
    rows: int  # in them
    findings: tuple[Finding, ...]

    @property
    def code(self) -> int:
        """0: all there; 3: something was repaired, or is missing and known to be; 1: something was lost."""
        weights = {finding.weight for finding in self.findings}
        return LOST if "lost" in weights else LOSSY if "lossy" in weights else GOOD


def verify(path: str | Path, progress: Progress = lambda _done, _of, _session: None) -> Verified:
    """Read all of a dataset, or of one session, and compare; nothing is changed.

    A session that is being recorded is checked as far as it is committed.

    Args:
        path: The dataset's folder, or the session's.
        progress: Told how far the check is.

    Raises:
        InputError: if there is neither.
    """
    root = Path(path)
    findings = list[Finding]()
    if (root / SESSION).exists():
        folders = [root]
    else:
        if not root.is_dir():
            raise InputError(str(root), "there is no such folder")
        try:
            read_dataset(root)
        except InputError as error:
            findings.append(Finding("", "lost", str(error)))
        folders = [session_folder(root, name) for name in session_names(root)]
        if findings and not folders:
            raise InputError(str(root), f"is no session, which has a {SESSION}, and no dataset")
    checks = [_Check(folder) for folder in folders]
    done, of = 0, sum(len(check.listed) for check in checks)
    for check in checks:
        for _ in check.carry_out():
            progress(done := done + 1, of, check.name)
        findings += check.findings
    read = [check.read for check in checks]
    return Verified(
        len(checks), sum(map(len, read)), sum(sum(each.values()) for each in read), tuple(findings)
    )


class _Check:
    """The check of one session."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.name = folder, folder.resolve().name
        self.findings: list[Finding] = []
        self.read: dict[str, int] = {}  # rows by file
        self.recording = locked(folder)
        self.listed: dict[str, Part] = {}
        try:
            self.listed = read_manifest(folder)
        except InputError as error:
            self._find("lost", str(error))

    def carry_out(self) -> Iterator[None]:
        """Check; give a turn after each file."""
        self._check_description()
        self._check_journal()
        for path, part in self.listed.items():
            try:
                self.read[path] = self._check_part(path, part)
            except InputError as error:
                self._find("lost", str(error))
            yield
        self._check_rest()

    def _find(self, weight: Weight, text: str) -> None:
        self.findings.append(Finding(self.name, weight, text))

    def _check_description(self) -> None:
        if self.recording:
            self._find("note", "is being recorded just now: what is committed is checked")
            return
        try:
            about = read_session(self.folder)
            self._check_ending(about)
            self._check_streams(about)
        except InputError as error:
            self._find("lost", str(error))
        except (AttributeError, LookupError, TypeError) as error:
            self._find("lost", f"{self.folder / SESSION}: does not say what it must: {error!r}")

    def _check_ending(self, about: Description) -> None:
        recovered = cast("dict[str, Any] | None", about.get("recovered"))
        if recovered is not None:
            rows = ", ".join(f"{count} rows of {table}" for table, count in recovered["rows"].items())
            self._find("lossy", f"was recovered: {rows or 'no rows'}")
            for each in recovered["lost"]:
                self._find("lossy", f"lost when it was recovered: {each}")
        elif "end_ns" not in about and not (self.folder / JOURNAL).exists():
            self._find("lossy", "was never closed: slipflow recover says as much in it")
        elif about.get("error"):
            self._find("note", f"ended early: {about['error']}")

    def _check_streams(self, about: Description) -> None:
        for name, sink in cast("dict[str, dict[str, int]]", about.get("sinks", {})).items():
            if sink["dropped"]:
                ours = name.startswith("dataset")
                self._find("lossy" if ours else "note", f"{sink['dropped']} rows for {name} were dropped")
        for name, stream in cast("dict[str, dict[str, Any]]", about.get("streams", {})).items():
            for gap in stream["gaps"]:
                seconds = (gap["end"] - gap["start"]) / 1e9
                self._find("note", f"{name} was down for {seconds:.1f} s: {gap['reason']}")

    def _check_journal(self) -> None:
        from storage import frames  # noqa: PLC0415 - what is not recorded or checked needs it not

        if self.recording or not (self.folder / JOURNAL).exists():
            return
        self._find("lossy", "has a journal that waits: slipflow recover puts it into parts")
        for number, path in segments(self.folder).items():
            try:
                segment = frames.read_segment(
                    files.read(path, frames.WHOLE), str(path), self._session(), number
                )
            except InputError as error:
                self._find("lost", str(error))
                continue
            if segment.damage and segment.damage.more:
                self._find("lost", f"{path.name}: is damaged at byte {segment.damage.offset}")

    def _session(self) -> str:
        return str(read_session(self.folder)["session"])

    def _check_part(self, path: str, part: Part) -> int:
        """Give its rows."""
        from storage import episodes, parts, schema  # noqa: PLC0415 - they import pyarrow

        table = _table(path)
        times = episodes.TIMES if table is None else ("time", "time")
        columns = episodes.SCHEMA if table is None else schema.schema(table)
        rows = parts.read_part(inside(self.folder, self.folder / path), columns, part.sha256)
        if parts.described(path, rows, part.sha256, times) != part:
            raise InputError(str(self.folder / path), "has other rows or times than the manifest says")
        if table and table is SAMPLES:
            for finger, batch in schema.from_arrow(table, table.kind, rows).items():
                if (batch.time[1:] < batch.time[:-1]).any():
                    self._find("lossy", f"{path}: rows of finger {finger} are not in the order of time")
        return len(rows)

    def _check_rest(self) -> None:
        """What the manifest does not list."""
        if (self.folder / DAMAGED).exists():
            self._find("lossy", f"has a folder {DAMAGED!r}: what could not be read when it was recovered")
        if self.recording or (self.folder / JOURNAL).exists():
            return
        if not (self.folder / MANIFEST).exists():
            self._find("lossy", f"has no {MANIFEST}: slipflow recover makes it from the parts")
        patterns = [EPISODES, *(table.pattern for table in TABLES)]
        found = [path for pattern in patterns for path in self.folder.glob(pattern)]
        for path in found:
            name = path.relative_to(self.folder).as_posix()
            if name not in self.listed:
                self._find("lossy", f"{name} is not listed in the manifest: slipflow recover looks at it")
        for path in (*self.folder.glob("*" + files.SCRATCH), *self.folder.glob("*/*" + files.SCRATCH)):
            self._find("note", f"{path.name} was left behind: slipflow recover deletes it")


def _table(path: str) -> Table | None:
    """The table that a file is of; None: the episodes."""
    return next((table for table in TABLES if path.startswith((f"{table.name}/", f"{table.name}."))), None)
