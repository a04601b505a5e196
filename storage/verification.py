"""Verification of a dataset: every file against the manifests, every page against its checksum."""

from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, cast

from operators.batch import s
from operators.errors import InputError
from operators.ports import Description
from storage import files
from storage.description import VersionError, read_dataset, read_session
from storage.files import locked
from storage.hand_labels import read_hand_labels
from storage.journal import journal_files
from storage.layout import DAMAGED, MANIFEST, SESSION, check_links, may_exist, named, session_folders
from storage.parts import Part, read_manifest, read_part
from storage.recovery import Recovery, scratch_files

Weight = Literal["note", "repairable", "repaired", "lossy", "lost"]
Progress = Callable[[int, int, str], object]  # files done, total files, session

_ORDER: Final[tuple[Weight, ...]] = ("note", "repairable", "repaired", "lossy", "lost")


@dataclass(frozen=True)
class SessionFinding:
    """Result of a check of a session.

    Note: not a fault. Repairable: a recovery can repair it without loss of rows on disk. Repaired: a recovery
    has done so; rows that a killed recorder could not write are unknown.
    Lossy: rows are known to be missing, because they were dropped, or not yet written when the recorder was
    killed. Lost: recorded rows are missing.
    """

    session: str
    weight: Weight
    text: str


@dataclass(frozen=True)
class Verified:
    """Result of the verification of a dataset."""

    sessions: int
    files: int  # readable Parquet files
    rows: int  # in them
    findings: tuple[SessionFinding, ...]

    @property
    def code(self) -> int:
        """Exit code: 0 good; 3 repaired, repairable, or known to be lossy; 1 lost."""
        return {"note": 0, "lost": 1}.get(self.worst, 3)

    @property
    def worst(self) -> Weight:
        """Weight of the worst finding; a note if there is none."""
        return _ORDER[max((_ORDER.index(finding.weight) for finding in self.findings), default=0)]


def verify(path: str | Path, progress: Progress = lambda _done, _total, _session: None) -> Verified:
    """Read and check all data of a dataset, or of one session, with the newest labels; nothing is changed.

    A session that is being recorded is checked up to its last commit. `progress` is called after each file.

    Raises:
        InputError: if `path` is neither, cannot be read, or it or one of its sessions has another version.
        EndpointError: if the disk fails, or memory or file descriptors are short.
    """
    root, findings = named(Path(path)), list[SessionFinding]()
    folders = session_folders(root, lost=True)
    if folders != [root]:
        try:
            read_dataset(root)
        except VersionError:  # nothing is lost
            raise
        except InputError as error:
            findings.append(SessionFinding("", "lost", str(error)))
        if not folders:
            text = "has no session: none was recorded, or all were deleted"
            findings.append(SessionFinding("", "note", text))
    checks = [_SessionCheck(root, folder) for folder in folders]
    done, total = 0, sum(len(check.listed) for check in checks)
    for check in checks:
        for _ in check.run():
            progress(done := done + 1, total, check.name)
        findings += check.findings
    rows = [rows for check in checks for rows in check.read]
    return Verified(len(checks), len(rows), sum(rows), tuple(findings))


class _SessionCheck:
    """Check of one session."""

    def __init__(self, root: Path, folder: Path) -> None:
        self.folder, self.name = folder, (folder.resolve() if folder == root else folder).name
        self.findings = list[SessionFinding]()
        self.read = list[int]()  # rows of each file that could be read
        self.about: Description = {}  # if session.json cannot be read
        self.listed: Mapping[str, Part] = {}
        self._has_links = self._has_manifest = True
        with self._losing():
            check_links(folder)
            self._has_links, self._has_manifest = False, False
            self._recording = locked(folder)
            with self._losing():
                self.about = read_session(folder) if may_exist(folder / SESSION) else {}
            self.listed = read_manifest(folder, self.about)
            self._has_manifest = True

    def run(self) -> Iterator[None]:
        """Check the session; yield after each file."""
        if self._has_links:  # reported already
            return
        self._check_description()
        for part in self.listed.values():
            try:
                self.read.append(len(read_part(self.folder, part)))
            except InputError as error:
                extent = f"{part.rows:,} rows, {(part.last - part.first) / s:.1f} s"
                self._add("lost", f"{error}; it had {extent}")
            yield
        with self._losing():
            read_hand_labels(self.folder, self.about)
        self._check_rest()

    def _add(self, weight: Weight, text: str) -> None:
        self.findings.append(SessionFinding(self.name, weight, text))

    @contextmanager
    def _losing(self) -> Generator[None]:
        """Add an InputError as a loss; data of another version is not lost and ends the check."""
        try:
            yield
        except VersionError:
            raise
        except InputError as error:
            self._add("lost", str(error))

    def _check_description(self) -> None:
        if self._recording:
            self._add("note", "is being recorded: checked up to its last commit")
        elif not may_exist(self.folder / SESSION):
            self._add("lost", f"its {SESSION} is missing; its readable rows are counted")
        elif self.about:
            try:
                if self.about["session"] != self.name:
                    named = f"its {SESSION} names session {self.about['session']!r}"
                    self._add("note", f"{named}: restore its own, unless the folder was renamed")
                self._check_ending(self.about)
                self._check_streams(self.about)
            except (ArithmeticError, AttributeError, LookupError, TypeError) as error:
                self.about = {}
                self._add("lost", f"{self.folder / SESSION}: has invalid content: {error!r}")

    def _check_ending(self, about: Description) -> None:
        recovered = cast("dict[str, Any] | None", about.get("recovered"))
        if recovered is not None:
            rows = ", ".join(f"{count} rows of {table}" for table, count in recovered["rows"].items())
            text = f"was recovered: {rows or 'all its rows were in parts'}"
            if "sinks" not in about:  # not closed, so it has no counts of dropped rows
                text += "; what the recorder could not write before it was killed is unknown"
            self._add("repaired", text)
            for each in recovered["lost"]:
                cut = each in recovered.get("cut", [])
                how = "cut off" if cut else "lost"
                self._add("lossy" if cut else "lost", f"{how} before it was recovered: {each}")
        elif about.get("error"):
            self._add("note", f"ended early: {about['error']}")

    def _check_streams(self, about: Description) -> None:
        sinks = cast("dict[str, dict[str, int]]", about.get("sinks", {}))
        for name, sink in sinks.items():
            if sink["dropped"]:
                weight: Weight = "lossy" if sink.get("records") else "note"
                self._add(weight, f"{sink['dropped']} rows for {name} were dropped")
        written = [sink["rows"] for sink in sinks.values() if sink.get("records")]
        found = sum(part.rows for part in self.listed.values())
        if len(written) == 1 and found < written[0]:  # several sinks are several datasets
            self._add("lost", f"{written[0] - found:,} of the {written[0]:,} recorded rows are in no part")
        for name, stream in cast("dict[str, dict[str, Any]]", about.get("streams", {})).items():
            for gap in stream["gaps"]:
                seconds = (gap["end"] - gap["start"]) / s
                self._add("note", f"{name} was down for {seconds:.1f} s: {gap['reason']}")

    def _check_rest(self) -> None:
        """Check what a recovery would find: the journal, unlisted files and missing ones."""
        if may_exist(self.folder / DAMAGED):
            self._add("repaired", f"has a folder {DAMAGED!r}, with files that a recovery moved there")
        if self._recording:
            return
        if journal_files(self.folder):
            self._add("repairable", "has a journal: slipflow verify --repair turns it into parts")
        if not self._has_manifest:  # reported already
            return
        if not may_exist(self.folder / MANIFEST):
            self._add("repairable", f"has no {MANIFEST} and no part: slipflow verify --repair writes it")
        with self._losing():
            try:
                recovery = Recovery(self.folder, self.about or {"session": self.name, "end_ns": 0})
            except OSError as error:
                raise files.read_error(error.filename or self.folder, error) from error
            for text in recovery.lost:
                self._add("lossy" if text in recovery.cut else "lost", text)
            for text in recovery.done:
                self._add("repairable", f"{text}: slipflow verify --repair repairs this")
        for path in scratch_files(self.folder):
            self._add("note", f"{path.name} was left over: slipflow verify --repair deletes it")
