import re
from pathlib import Path

import pytest

from flows.cli import verification_page
from flows.cli.verification_page import report, summary, write
from operators.batch import s
from operators.errors import EndpointError, ParameterError
from storage.manifest import Part
from storage.verification import Checked, SessionFinding, Verified

LOST = SessionFinding("b", "lost", "touch/part-000001.parquet: <gone>: 50 rows, 10.0 s")


def checked(session: str, number: int, *, whole: bool = True, count: int = 50) -> Checked:
    part = Part(f"touch/part-{number:06}.parquet", count, number * 10 * s, (number + 1) * 10 * s, "0" * 64)
    return Checked(session, part, whole)


def verified(*findings: SessionFinding, whole: bool = True) -> Verified:
    parts = (checked("a", 0), checked("b", 0), checked("b", 1, whole=whole))
    return Verified(2, 3 if whole else 2, 150 if whole else 100, findings, parts, ("a", "b"))


def test_the_title_states_that_all_data_is_present(tmp_path: Path) -> None:
    made = report(verified(), tmp_path / "data", "")
    assert made.title == "data: 2 sessions, 3 files, 150 rows: all data is present"
    assert [section.finding for section in made.sections] == [
        "All 3 listed files can be read",
        "No faults; 0 notes",
    ]
    assert made.sections[1].tables == []


def test_lost_rows_are_listed_by_session_and_by_finding(tmp_path: Path) -> None:
    note = SessionFinding("a", "note", "touch was down for 2.0 s: unplugged")
    made = report(verified(LOST, note, whole=False), tmp_path / "data", "")
    sessions, findings = made.sections
    assert made.title.endswith(": recorded data is lost")
    assert sessions.finding == "1 of 3 listed files cannot be read: 50 rows"
    assert [[row[0], *row[2:]] for row in sessions.tables[0].rows] == [
        ["a", 50, 0, 10.0, 1, "note"],
        ["b", 50, 50, 20.0, 1, "lost"],
    ]
    assert findings.finding == "1 finding in 1 session; 1 note"
    assert len(findings.tables[0].rows) == 2


def test_the_time_for_a_report_is_proportional_to_the_number_of_sessions(tmp_path: Path) -> None:
    class Name(str):
        __slots__ = ()
        compared = 0
        __hash__ = str.__hash__

        def __eq__(self, other: object) -> bool:
            Name.compared += 1
            return str.__eq__(self, other)

    names = tuple(Name(number) for number in range(200))
    parts = tuple(checked(name, 0) for name in names)
    report(Verified(200, 200, 10_000, (LOST,) * 200, parts, names), tmp_path / "data", "")
    assert Name.compared < 10 * len(names)


def test_the_page_is_one_file_with_its_command(tmp_path: Path) -> None:
    out = tmp_path / "my page.html"
    write(verified(LOST, whole=False), tmp_path / "data", out)
    text = out.read_text()
    assert f"slipflow verify {tmp_path / 'data'} --report '{out}'" in text
    assert "&lt;gone&gt;" in text
    assert not re.search(r'(?:src|href)="(?!#)', text)


def test_the_json_result_has_the_findings() -> None:
    assert summary(verified(LOST, whole=False)) == {
        "sessions": 2,
        "files": 2,
        "rows": 100,
        "findings": [{"session": "b", "weight": "lost", "text": LOST.text}],
        "worst": "lost",
        "code": 1,
    }


def test_notes_are_not_faults() -> None:
    assert summary(verified(SessionFinding("a", "note", "touch was down for 2.0 s")))["worst"] == "good"
    assert summary(verified())["worst"] == "good"


def test_a_page_that_cannot_be_created_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"ends in \.html"):
        verification_page.check_file(tmp_path / "report.pdf")
    (tmp_path / "file").touch()
    with pytest.raises(EndpointError, match="does not exist"):
        verification_page.check_file(tmp_path / "file" / "report.html")
    (tmp_path / "folder.html").mkdir()
    with pytest.raises(EndpointError, match="is a folder"):
        verification_page.check_file(tmp_path / "folder.html")
    with pytest.raises(EndpointError, match="cannot be written"):
        write(verified(), tmp_path, tmp_path / "folder.html")
