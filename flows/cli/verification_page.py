"""Report of a verification: its page and its JSON result."""

import shlex
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from flows.cli.terminal import check_output_file
from flows.report.report_page import Report, Section
from flows.report.table import Table, Value, counted
from operators.batch import s
from operators.errors import EndpointError, ParameterError, os_error_reason
from storage.verification import Checked, SessionFinding, Verified, Weight, heaviest

VERDICTS: Final[Mapping[Weight, str]] = MappingProxyType(
    {
        "note": "all data is present",
        "repairable": "repairable, all rows on disk can be recovered",
        "repaired": "repaired, all rows on disk were recovered",
        "lossy": "rows are known to be missing",
        "lost": "recorded data is lost",
    }
)


def check_file(path: Path) -> None:
    """Require that the page can be created, before anything is read.

    Raises:
        ParameterError: if its name does not end in ``.html``.
        EndpointError: if its folder does not exist.
    """
    if path.suffix != ".html":
        raise ParameterError("verify", "report", str(path), "a file name that ends in .html")
    check_output_file(path)


def write(found: Verified, dataset: Path, path: Path) -> None:
    """Write the page about a verification of a dataset or session.

    Raises:
        EndpointError: if it cannot be written.
    """
    command = shlex.join(["slipflow", "verify", str(dataset), "--report", str(path)])
    try:
        path.write_text(report(found, dataset, command).html(), encoding="utf-8")
    except OSError as error:
        raise EndpointError(str(path), f"cannot be written: {os_error_reason(error)}") from error


def summary(found: Verified) -> dict[str, Any]:
    """Return the result as JSON data."""
    return {
        "sessions": found.sessions,
        "files": found.files,
        "rows": found.rows,
        "findings": [asdict(finding) for finding in found.findings],
        "worst": "good" if found.worst == "note" else found.worst,  # a note is not a fault
        "code": found.code,
    }


def size(found: Verified) -> str:
    """Return the numbers of sessions, files and rows as text."""
    return (
        f"{counted(found.sessions, 'session')}, {counted(found.files, 'file')}, {counted(found.rows, 'row')}"
    )


def report(found: Verified, dataset: Path, command: str) -> Report:
    """Return the report about a verification of a dataset or session by `command`."""
    text = (
        "Every file was compared with the manifest: SHA-256, page checksums, rows and times. lost: recorded"
        " data is missing or damaged. lossy: rows are known to be missing. repaired and repairable: no row on"
        " disk is lost. note: not a fault."
    )
    title = f"{dataset.resolve().name}: {size(found)}: {VERDICTS[found.worst]}"
    return Report(title, text, [_sessions(found), _findings(found)], command)


def _sessions(found: Verified) -> Section:
    rows = list[list[Value]]()
    parts_of = defaultdict[str, list[Checked]](list)
    for checked in found.parts:
        parts_of[checked.session].append(checked)
    findings_of = defaultdict[str, list[SessionFinding]](list)
    for fault in found.findings:
        findings_of[fault.session].append(fault)
    for name in found.names:
        parts, findings = parts_of[name], findings_of[name]
        unread = sum(each.part.rows for each in parts if not each.whole)
        readable = sum(each.part.rows for each in parts) - unread
        dated = [each.part for each in parts if each.part.rows]
        span = max((part.last for part in dated), default=0) - min((part.first for part in dated), default=0)
        worst = heaviest(findings) if findings else "all present"
        rows.append([name, len(parts), readable, unread, span / s, len(findings), worst])
    broken = [each for each in found.parts if not each.whole]
    every = counted(len(found.parts), "listed file")
    finding = f"{every} can be read" if len(found.parts) == 1 else f"All {every} can be read"
    if broken:
        lost = counted(sum(each.part.rows for each in broken), "row")
        finding = f"{len(broken):,} of {every} cannot be read: {lost}"
    head = ["session", "files", "rows", "unreadable rows", "span, s", "findings", "worst"]
    text = "The span is the time from the first to the last row."
    return Section("sessions", finding, text, [Table(head, rows)])


def _findings(found: Verified) -> Section:
    faults = [finding for finding in found.findings if finding.weight != "note"]
    sessions = len({finding.session for finding in faults})
    notes = counted(len(found.findings) - len(faults), "note")
    title = f"No faults; {notes}"
    if faults:
        title = f"{counted(len(faults), 'finding')} in {counted(sessions, 'session')}; {notes}"
    rows = [[finding.text, finding.session, finding.weight] for finding in found.findings]
    tables = [Table(["finding", "session", "weight"], rows)] if rows else []
    return Section("findings", title, "As `slipflow verify` prints them.", tables)
