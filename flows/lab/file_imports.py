"""Import of many files: all are read and checked before anything is written."""

import json
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, TypeAlias

from connectors.files.column_map import COUNTS, ColumnMap
from connectors.files.resolution import Steps, common
from flows.lab.importing import TraceImport, session_name, stored
from flows.report.table import Table, Value, counted
from operators.errors import EndpointError, InputError, ParameterError, SlipflowError
from operators.fingertip import RATE_TOLERANCE
from storage.description import read_session
from storage.layout import session_folder, session_names

Make: TypeAlias = Callable[[Path, ColumnMap, str, str | None], TraceImport]  # file, map, session, group

_KEPT_ROWS: Final = 2_000_000  # rows of traces that are kept instead of being read again


@dataclass
class CheckedFile:
    """File that was read and checked, but not written yet.

    Args:
        path: The file.
        session: Name of its session.
        group: Surface or object.
        existing: True if the dataset has it already.
    """

    path: Path
    session: str
    group: str | None = None
    existing: bool = False
    error: str = field(default="", init=False)
    summary: dict[str, Any] = field(default_factory=dict[str, Any], init=False)
    report: str = field(default="", init=False)
    interpretation: tuple[str, ...] = field(default=(), init=False)
    steps: Steps | None = field(default=None, init=False)
    trace_import: TraceImport | None = field(default=None, init=False)  # None: read again


class FileImports:
    """Files of one sensor, read and checked; `write` adds a session of each to a dataset.

    The files get a common resolution, so that a detector can be trained on all of them.

    Args:
        paths: The files.
        out: Folder of the dataset.
        columns: Map of the columns of each file.
        make: Reads a file.
        group: Regular expression that is searched in the name of each file; its first group, or the whole
            match, is the surface or object.
        session: Name of the session of a single file (default: the file's name).
        skip_existing: Leave out files that the dataset has already.
        progress: Called with the number of files read, the number of files and the name of the next.

    Raises:
        InputError: if a file lacks a group, two files have the same name, or the dataset has a session of
            that name.
        ParameterError: on an invalid pattern, a session name for several files, or a file as dataset.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        out: Path,
        columns: ColumnMap,
        make: Make,
        *,
        group: str = "",
        session: str | None = None,
        skip_existing: bool = False,
        progress: Callable[[int, int, str], None] = lambda _done, _total, _part: None,
    ) -> None:
        if out.is_file():
            must_be = "a folder: the last argument is the dataset to write"
            raise ParameterError("import", "OUT", str(out), must_be)
        if session and len(paths) > 1:
            raise ParameterError("import", "--session", session, "left out if there are several files")
        self._out, self._columns, self._make = out, columns, make
        names = [session] if session else sessions_of(paths)
        self.files = [
            CheckedFile(path, name, group_of(path, group)) for path, name in zip(paths, names, strict=True)
        ]
        recorded = set(session_names(out)) if out.is_dir() else set[str]()
        kept = 0
        for number, file in enumerate(self.files):
            progress(number, len(self.files), file.path.name)
            try:
                found = make(file.path, columns, file.session, file.group)
            except SlipflowError as error:
                if len(self.files) == 1 or isinstance(error, ParameterError):
                    raise
                file.error = str(error)
                continue
            file.summary, file.report = found.summary(), found.report()
            file.interpretation = tuple(found.interpretation())
            file.steps = found.trace.steps
            if file.session in recorded:
                self._check_existing(file, skip=skip_existing)
            kept += len(found.trace.touch)
            if kept <= _KEPT_ROWS or len(self.files) == 1:
                file.trace_import = found
        self._share_resolution()

    @property
    def failed(self) -> int:
        """Number of files that cannot be imported."""
        return sum(bool(file.error) for file in self.files)

    async def write(
        self, progress: Callable[[int, int, str], None] = lambda _done, _total, _part: None
    ) -> int:
        """Write the sessions; return their number.

        Args:
            progress: Called with the number of files written, the number of files and the name of the next.

        Raises:
            InputError: if a file cannot be imported, or was changed since it was checked.
            EndpointError: if the dataset cannot be written.
        """
        if self.failed:
            first = next(file.error for file in self.files if file.error)
            raise InputError(
                f"{self.failed} of {counted(len(self.files), 'file')}",
                f"cannot be imported, so nothing was written; the first: {first}",
            )
        new = [file for file in self.files if not file.existing]
        for number, file in enumerate(new):
            progress(number, len(new), file.path.name)
            found = file.trace_import or self._make(file.path, self._columns, file.session, file.group)
            file.trace_import = None
            if found.trace.sha256 != file.summary["sha256"]:
                raise InputError(str(file.path), "was changed while it was imported: repeat the command")
            try:
                await found.write()
            except EndpointError as error:
                written = f"({counted(number, 'session')} written; continue with --skip-existing)"
                reason = f"{error.reason} {written}" if number else error.reason
                raise EndpointError(error.endpoint, reason) from error
        return len(new)

    def _check_existing(self, file: CheckedFile, *, skip: bool) -> None:
        """Mark a file whose session exists.

        Raises:
            EndpointError: unless it is to be skipped, and is the same file.
        """
        about = read_session(session_folder(self._out, file.session))
        sources: Any = about.get("sources")
        same = f'"sha256": "{file.summary["sha256"]}"' in json.dumps(sources)
        if same and not about.get("complete"):
            reason = f"session {file.session!r} of the same file is incomplete: delete it and import it again"
        elif same:
            reason = f"already has a session {file.session!r} of the same file: --skip-existing leaves it out"
        else:
            reason = f"already has a session {file.session!r} of another file: rename the file"
        if not (skip and same and about.get("complete")):
            raise EndpointError(str(self._out), reason)
        file.existing = True

    def _share_resolution(self) -> None:
        """Give all files the same resolution."""
        needs = [file.steps for file in self.files if file.steps is not None]
        if self._columns.resolution is not None or not needs:
            return
        offset = not any(file.summary["zeroed"] for file in self._good)
        resolution = common(needs, offset=offset)
        self._columns = replace(self._columns, resolution=resolution)
        for file in self._good:
            if file.summary["resolution"] != resolution:
                file.trace_import, file.summary["resolution"] = None, resolution

    @property
    def _good(self) -> list[CheckedFile]:
        return [file for file in self.files if not file.error]

    @property
    def warnings(self) -> list[str]:
        """Warnings about files that differ, and those of each file."""
        lines = list[str]()
        good = self._good
        for name, get in _COMPARED.items():
            values = Counter(get(file.summary) for file in good)
            if len(values) > 1:
                (usual, _), (other, _) = values.most_common()[0], values.most_common()[-1]
                odd = next(file.path.name for file in good if get(file.summary) == other)
                lines.append(f"the files differ in {name}: most have {usual}, {odd} has {other}")
        rates = [file.summary["rate"] for file in good if file.summary["rate"]]
        if rates and max(rates) > min(rates) * (1 + RATE_TOLERANCE):
            lines.append(f"the rates differ: {min(rates):.4g} to {max(rates):.4g} Hz")
        lines += [f"{file.path.name}: {each}" for file in good for each in file.summary["warnings"]]
        return lines

    def summary(self) -> dict[str, Any]:
        """Return the interpretation of the files as JSON data."""
        return {
            "dataset": str(self._out),
            "skipped": sum(file.existing for file in self.files),
            "warnings": self.warnings,
            "files": [
                {"file": str(file.path), "session": file.session, "error": file.error}
                if file.error
                else {"file": str(file.path), **file.summary}
                for file in self.files
            ],
        }

    def report(self) -> str:
        """Return the interpretation of the files as text."""
        good = self._good
        if len(self.files) == 1:
            return self.files[0].report
        lines = list[str]()
        for interpretation in dict.fromkeys(file.interpretation for file in good):
            first, *rest = (file for file in good if file.interpretation == interpretation)
            others = f" and {counted(len(rest), 'other file')}" if rest else ""
            lines += [f"{first.path.name}{others}:", *interpretation]
            lines += stored([file.summary for file in (first, *rest)])
        head = ["file", "group", "rows", "s", "Hz", "slip %", "moving %", "missing", "state"]
        rows = [_row(file) for file in self.files]
        shown = [
            column
            for column, name in enumerate(head)
            if name in ("file", "rows") or any(row[column] not in (None, 0, "new") for row in rows)
        ]
        table = Table([head[column] for column in shown], [[row[column] for column in shown] for row in rows])
        lines += ["", table.markdown(), ""]
        groups = Counter(file.group for file in self.files if file.group)
        if groups:
            lines += [f"groups: {', '.join(f'{name} {count}' for name, count in groups.items())}"]
        lines += [f"warning: {each}" for each in self.warnings]
        lines += self._errors()
        new = len(good) - sum(file.existing for file in good)
        return "\n".join([*lines, f"{counted(new, 'session')} of {self._out}"])

    def _errors(self) -> list[str]:
        """Return the errors of the files; one that many files have is one line."""
        found = dict[str, list[CheckedFile]]()
        for file in self.files:
            if file.error:
                found.setdefault(file.error.removeprefix(str(file.path)), []).append(file)
        return [
            f"error: {first.error}" + (f" (as in {counted(len(rest), 'other file')})" if rest else "")
            for first, *rest in found.values()
        ]


def sessions_of(paths: Sequence[Path]) -> list[str]:
    """Return a session name for each file; files of the same name get that of their folder too.

    >>> sessions_of([Path("a/1.csv"), Path("b/1.csv"), Path("b/2.csv")])
    ['a-1', 'b-1', '2']

    Raises:
        InputError: if two names are still the same.
    """
    names = [session_name(str(path)) for path in paths]
    often = Counter(names)
    names = [
        session_name(f"{path.parent.name}-{path.name}") if often[name] > 1 else name
        for path, name in zip(paths, names, strict=True)
    ]
    seen = dict[str, Path]()
    for path, name in zip(paths, names, strict=True):
        if (other := seen.setdefault(name.casefold(), path)) is not path:
            raise InputError(str(path), f"has the same session name as {other}: {name}; rename one")
    return names


def group_of(path: Path, pattern: str) -> str | None:
    """Return the surface or object that a file's name states; None without a pattern.

    >>> group_of(Path("data/steel_vel3.csv"), "(.+)_vel"), group_of(Path("12_wood.csv"), "[a-z]+")
    ('steel', 'wood')

    Raises:
        InputError: if the name does not match.
        ParameterError: if the pattern is invalid.
    """
    if not pattern:
        return None
    try:
        match = re.search(pattern, path.name)
    except re.error as error:
        raise ParameterError("import", "--group", pattern, f"a regular expression: {error}") from None
    group = match and match[min(1, match.re.groups)]
    if not group:
        raise InputError(str(path), f"has no group: its name does not match --group {pattern!r}")
    return group


def _row(file: CheckedFile) -> list[Value]:
    found = file.summary
    if file.error:
        return [file.path.name, file.group, None, None, None, None, None, None, "error"]
    labelled = found["labelled"] == "the file"
    rows, motion = found["rows"], found["motion"]
    return [
        file.path.name,
        file.group,
        rows,
        found["seconds"],
        found["rate"],
        100 * found["labels"]["slip"] / rows if labelled else None,
        100 * found["moving"] / motion if motion else None,
        found["missing"],
        "already there" if file.existing else "new",
    ]


_COMPARED: Final[dict[str, Callable[[dict[str, Any]], object]]] = {
    "their cells": lambda found: counted(len(found["columns"][COUNTS]), "cell"),
    "their unit": lambda found: found["unit"],
    "being zeroed": lambda found: "negative readings (zeroed)" if found["zeroed"] else "none (raw)",
    "their labels": lambda found: f"labels by {found['labelled']}" if found["labelled"] else "none",
}
