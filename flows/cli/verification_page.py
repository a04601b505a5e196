"""What a check of a dataset leaves: one page that says what is there and what is wrong."""

import shlex
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from flows.cli.options import check_output_file, counted
from flows.cli.verification_figure import LANES, by_session, lanes
from flows.report.figures import lacking
from flows.report.page import Page, Section, Table
from operators.batch import s
from operators.errors import EndpointError, ParameterError, os_error_reason
from storage.findings import Finding, Weight, heaviest
from storage.verification import Verified

SAID: Final[Mapping[Weight, str]] = MappingProxyType(
    {
        "note": "all is there",
        "repairable": "something waits to be repaired, nothing is lost",
        "repaired": "something was repaired, nothing is lost",
        "lossy": "something is known to be missing",
        "lost": "something is lost",
    }
)


def claim(path: Path) -> None:
    """Make sure that a page can be written there, before anything is read.

    Raises:
        ParameterError: if its name does not end in ``.html``.
        EndpointError: if its folder is not there.
    """
    if path.suffix != ".html":
        raise ParameterError("verify", "report", str(path), "a file name that ends in .html")
    check_output_file(path)


def write(found: Verified, place: Path, path: Path) -> None:
    """Write the page about a check of `place`.

    Raises:
        EndpointError: if it cannot be written.
    """
    command = shlex.join(["slipflow", "verify", str(place), "--report", str(path)])
    try:
        path.write_text(page(found, place, command).html(), encoding="utf-8")
    except OSError as error:
        raise EndpointError(str(path), f"cannot be written: {os_error_reason(error)}") from error


def summary(found: Verified) -> dict[str, Any]:
    """The same for a program."""
    return {
        "sessions": found.sessions,
        "files": found.files,
        "rows": found.rows,
        "findings": [asdict(finding) for finding in found.findings],
        "worst": "good" if found.worst == "note" else found.worst,  # a note says nothing against it
        "code": found.code,
    }


def page(found: Verified, place: Path, command: str) -> Page:
    """The findings; `command` made them."""
    size = (
        f"{counted(found.sessions, 'session')}, {counted(found.files, 'file')}, {counted(found.rows, 'row')}"
    )
    text = (
        "Every file was held against the manifest: its sha256, the checksums of its pages, its rows and"
        " times. Lost is what had been recorded; lossy what was known not to be there; repaired and"
        " repairable have lost no row; a note says nothing against a session."
    )
    name = place.resolve().name
    return Page(f"{name}: {size}: {SAID[found.worst]}", text, [_sessions(found), _findings(found)], command)


def _sessions(found: Verified) -> Section:
    rows: list[list[str]] = []
    said = dict[str, list[Finding]]()
    for finding in found.findings:
        said.setdefault(finding.session, []).append(finding)
    for name, parts in by_session(found).items():
        unread = sum(each.part.rows for each in parts if not each.whole)
        dated = [each.part for each in parts if each.part.rows]
        first = min((part.first for part in dated), default=0)
        last = max((part.last for part in dated), default=0)
        findings = said.get(name, [])
        rows.append(
            [
                name,
                f"{len(parts):,}",
                f"{sum(each.part.rows for each in parts) - unread:,}",
                f"{unread:,}",
                f"{(last - first) / s:,.1f}",
                f"{len(findings):,}",
                heaviest(findings) if findings else "all there",
            ]
        )
    broken = [each for each in found.parts if not each.whole]
    title = f"All {counted(len(found.parts), 'listed file')} can be read"
    if broken:
        lost = counted(sum(each.part.rows for each in broken), "row")
        title = f"{len(broken):,} of {counted(len(found.parts), 'listed file')} cannot be read: {lost}"
    text = (
        "Rows of a session that can be read are blue, those that cannot be are red, by event time since its"
        " first row; the height is the rows in a second. A white span has none."
    )
    if found.sessions > LANES:
        text += f" Of {found.sessions:,} sessions {LANES} are drawn, those with most that is wrong first."
    if reason := lacking():
        text = f"Figures {reason}."
    head = ["session", "files", "rows", "rows that cannot be read", "span, s", "findings", "worst"]
    drawn = lanes(found) if any(each.part.rows for each in found.parts) and not reason else None
    return Section("sessions", title, text, [Table(head, rows)], drawn)


def _findings(found: Verified) -> Section:
    wrong = [finding for finding in found.findings if finding.weight != "note"]
    where = len({finding.session for finding in wrong})
    notes = counted(len(found.findings) - len(wrong), "note")
    title = f"Nothing is wrong; {notes}"
    if wrong:
        title = f"{counted(len(wrong), 'finding')} in {counted(where, 'session')}; {notes}"
    rows = [[finding.text, finding.session, finding.weight] for finding in found.findings]
    tables = [Table(["what", "session", "weight"], rows)] if rows else []
    return Section("findings", title, "As `slipflow verify` prints them.", tables)
