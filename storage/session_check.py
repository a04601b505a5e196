"""The check of one session: what is listed, what is not, what is gone, what the journal holds."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

from operators.errors import InputError, os_error_reason
from operators.ports import Description
from storage import files
from storage.description import read_session, recorders
from storage.findings import Finding, Weight
from storage.layout import (
    DAMAGED,
    JOURNAL,
    MANIFEST,
    SAMPLES,
    SESSION,
    TABLES,
    Table,
    headless,
    inside,
    segments,
    single_log,
)
from storage.lock import locked
from storage.manifest import Part, read_manifest


class SessionCheck:
    """The check of one session.

    Attributes:
        folder: The session's.
        name: Its name.
        findings: What is not as it should be, so far.
        read: Rows of the files that could be read, by path, so far.
        listed: What the manifest lists, by path.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.name = folder, folder.resolve().name
        self.findings: list[Finding] = []
        self.read: dict[str, int] = {}  # rows by file
        self.recording = locked(folder)
        self.listed: dict[str, Part] = {}
        self.about: Description = {}  # session.json, if it can be read
        try:
            self.listed = read_manifest(folder)
        except InputError as error:
            self._find("lost", str(error))

    def carry_out(self) -> Iterator[None]:
        """Check; give a turn after each file."""
        try:
            yield from self._check_all()
        except OSError as error:  # what it looks into by itself; files are read with typed errors
            self._find("lost", f"{error.filename or self.folder}: cannot be read: {os_error_reason(error)}")

    def _check_all(self) -> Iterator[None]:
        from storage import unlisted  # noqa: PLC0415 - it imports pyarrow

        self._check_description()
        self._check_journal()
        for path, part in self.listed.items():
            try:
                self.read[path] = self._check_part(path, part)
            except InputError as error:
                self._find("lost", f"{error}; it held {unlisted.extent(part)}")
            yield
        self._check_rest()

    def _find(self, weight: Weight, text: str) -> None:
        self.findings.append(Finding(self.name, weight, text))

    def _check_description(self) -> None:
        if self.recording:
            self._find("note", "is being recorded just now: what is committed is checked")
            return
        if headless(self.folder):
            self._find("lost", f"its {SESSION} is gone; rows are counted here as far as they can be read")
            return
        try:
            about = self.about = read_session(self.folder)
            self._check_ending(about)
            self._check_streams(about)
        except InputError as error:
            self._find("lost", str(error))
        except (AttributeError, LookupError, TypeError) as error:
            self.about = {}
            self._find("lost", f"{self.folder / SESSION}: does not say what it must: {error!r}")

    def _check_ending(self, about: Description) -> None:
        recovered = cast("dict[str, Any] | None", about.get("recovered"))
        if recovered is not None:
            rows = ", ".join(f"{count} rows of {table}" for table, count in recovered["rows"].items())
            self._find("repaired" if rows else "lossy", f"was recovered: {rows or 'no rows'}")
            for each in recovered["lost"]:
                cut = each in recovered.get("cut", [])
                self._find(
                    "lossy" if cut else "lost",
                    f"{'cut off' if cut else 'lost'} before it was recovered: {each}",
                )
        elif "end_ns" not in about and not (self.folder / JOURNAL).exists():
            reason = "was never closed, and has no journal: what came after its last part is missing"
            self._find("lossy", f"{reason}; slipflow recover says so in it")
        elif about.get("error"):
            self._find("note", f"ended early: {about['error']}")

    def _check_streams(self, about: Description) -> None:
        keep = recorders(about)
        for name, sink in cast("dict[str, dict[str, int]]", about.get("sinks", {})).items():
            if sink["dropped"]:
                weight: Weight = "lossy" if name in keep else "note"
                self._find(weight, f"{sink['dropped']} rows for {name} were dropped")
        for name, stream in cast("dict[str, dict[str, Any]]", about.get("streams", {})).items():
            for gap in stream["gaps"]:
                seconds = (gap["end"] - gap["start"]) / 1e9
                self._find("note", f"{name} was down for {seconds:.1f} s: {gap['reason']}")

    def _check_journal(self) -> None:
        from storage import frames, unlisted  # noqa: PLC0415 - unlisted imports pyarrow

        if self.recording or not (self.folder / JOURNAL).exists():
            return
        self._find("repairable", "has a journal that waits: slipflow recover puts it into parts")
        for text in unlisted.missing_segments(self.folder, self.about):
            self._find("lost" if self.listed or segments(self.folder) else "lossy", text)
        waiting, single = [*segments(self.folder).items()], single_log(self.folder)
        waiting += [(frames.SINGLE_LOG, single)] if single.exists() else []
        for number, path in waiting:
            try:
                segment = frames.read_segment(
                    files.read(path, frames.WHOLE),
                    str(path),
                    str(self.about.get("session", self.name)),
                    number,
                )
            except InputError as error:
                self._find("lost", str(error))
                continue
            if segment.damage and segment.damage.more:
                self._find("lost", f"{path.name}: is damaged at byte {segment.damage.offset}")
            elif segment.damage:
                self._find("lossy", f"{path.name}: its last {segment.damage.size} bytes cannot be read")

    def _check_part(self, path: str, part: Part) -> int:
        """Give its rows."""
        from storage import parts, schema  # noqa: PLC0415 - they import pyarrow

        table = _table(path)
        rows = parts.read_part(inside(self.folder, self.folder / path), schema.schema(table), part.sha256)
        if parts.described(path, rows, part.sha256) != part:
            raise InputError(str(self.folder / path), "has other rows or times than the manifest says")
        if table is SAMPLES:
            for finger, batch in schema.from_arrow(table, table.kind, rows).items():
                if (batch.time[1:] < batch.time[:-1]).any():
                    self._find("lossy", f"{path}: rows of finger {finger} are not in the order of time")
        return len(rows)

    def _check_rest(self) -> None:
        """What the manifest does not list."""
        if (self.folder / DAMAGED).exists():
            self._find("repaired", f"has a folder {DAMAGED!r}: what a recovery put aside")
        if self.recording or (self.folder / JOURNAL).exists():
            return
        if not (self.folder / MANIFEST).exists():
            self._find("repairable", f"has no {MANIFEST}: slipflow recover makes it from the parts")
        self._check_gone([*self.listed, *self._check_unlisted()])
        for path in (*self.folder.glob("*" + files.SCRATCH), *self.folder.glob("*/*" + files.SCRATCH)):
            self._find("note", f"{path.name} was left behind: slipflow recover deletes it")

    def _check_unlisted(self) -> list[str]:
        """Give the files that are there, but not those that are there twice."""
        from storage import unlisted  # noqa: PLC0415 - it imports pyarrow

        there = list[str]()
        for table in TABLES:
            found = [path.relative_to(self.folder).as_posix() for path in self.folder.glob(table.pattern)]
            paths = sorted(found, key=unlisted.part_number)
            follow = unlisted.followers(self.folder, table, paths, self.listed)
            for path in paths:
                if path not in follow:
                    self._find(
                        "repairable",
                        f"{path} has rows that are there already: slipflow recover puts it aside",
                    )
            there += follow
        for path in there:
            if path not in self.listed:
                self._check_readable(path)
        return there

    def _check_readable(self, path: str) -> None:
        """A file that the manifest does not list: a recovery lists it, if it can be read."""
        from storage import parts, schema  # noqa: PLC0415 - they import pyarrow

        try:
            parts.read_part(inside(self.folder, self.folder / path), schema.schema(_table(path)))
        except InputError as error:
            self._find("lost", f"{error}; it is not in the manifest")
        else:
            self._find("repairable", f"{path} is not in the manifest: slipflow recover adds it")

    def _check_gone(self, paths: list[str]) -> None:
        """What no file is left of; what a recovery told of is known."""
        from storage import unlisted  # noqa: PLC0415 - it imports pyarrow

        recovered = cast("dict[str, Any]", self.about.get("recovered", {}))
        known: list[str] = recovered.get("lost", [])
        for path in unlisted.missing_numbers(paths):
            if not any(path in each for each in known):
                self._find("lost", f"{path}: is gone, and no manifest tells of it")
        if len(self.listed) == len(set(paths)):  # else what is there is not known
            text = unlisted.shortfall(self.about, self.listed.values())
            if text and text not in known:
                self._find("lost", text)


def _table(path: str) -> Table:
    """Return the table that a file belongs to."""
    return next(table for table in TABLES if path.startswith((f"{table.name}/", f"{table.name}.")))
