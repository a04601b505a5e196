"""The checks of `tests.readability` find each kind of fault."""

from pathlib import Path

import pytest

from flows.report.figures import Figure, grid, styled
from flows.report.report_page import Report, Section
from flows.report.table import Table
from tests.readability import ReportFaults


@styled
def crowded() -> Figure:
    figure, (axis,) = grid(1, 1, (4, 2))
    axis.set_xticks([0, 0.01, 1], ["first label", "second label", "third"])
    return figure


@styled
def pale() -> Figure:
    figure, (axis,) = grid(1, 1, (14, 2))
    axis.set_xlabel("pale text", color="#bbbbbb")
    return figure


def page(*sections: Section) -> Report:
    return Report("Title", "Text.", sections, "slipflow demo")


def test_a_page_without_faults_has_none(tmp_path: Path, report_faults: ReportFaults) -> None:
    wide = Table([f"column {k}" for k in range(12)], [["`code`", *map(float, range(11))]])
    assert report_faults(page(Section("one", "Finding with `code`", "Text.", [wide])), tmp_path) == []


@pytest.mark.parametrize(
    ("section", "fault"),
    [
        (Section("one", "Finding", "Lone ` backtick."), "1280 px, light: backtick"),
        (Section("one", "Finding", "Text.", draw=crowded), 'overlap: "first label" and "second label"'),
        (Section("one", "Finding", "Text.", draw=pale), '1280 px, light: contrast 1.92: "pale text"'),
        (Section("one", "Finding", "Text.", draw=pale), "1280 px, light: figure of"),
        (Section("one", "Finding", "Text.", [Table(["x", "y" * 300], [[1, 2]])]), "1280 px, dark: table of"),
        (Section("one", "1 methods found", "Text."), '390 px, light: wording: "1 methods found"'),
        (Section("one", "rotation - %", "Text."), 'wording: "- %"'),
    ],
)  # fmt: skip
def test_each_kind_of_fault_is_found(
    section: Section, fault: str, tmp_path: Path, report_faults: ReportFaults
) -> None:
    found = report_faults(page(section), tmp_path)
    assert any(fault in each for each in found), found
