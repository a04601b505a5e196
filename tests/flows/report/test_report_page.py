import errno
import json
import os
from itertools import compress
from pathlib import Path
from unittest.mock import patch

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flows.report.figures import Figure, grid
from flows.report.report_page import Report, Section, check_output_folder
from flows.report.table import Table
from operators.errors import EndpointError

TABLE = Table(["method", "F1 < 90"], [["<b>tcn</b>", "1 & 2"], ["psd", 3.25]], caption="a > b")


def figure() -> Figure:
    drawn, (axis,) = grid(1, 1, (2, 2))
    axis.plot([0, 1], label="x")
    axis.set(title="A <title>", xlabel="x")
    axis.imshow([[0, 1], [1, 0]])
    return drawn


def report() -> Report:
    sections = [Section(name, f"{name} & so <on>", "text", [TABLE], figure) for name in ("one", "two")]
    sections.append(Section("three", "detail", "text", [TABLE], folded=True))
    return Report("A <page>", "of & findings", sections, "slipflow evaluate 'a<b>'")


def test_text_is_escaped_in_html() -> None:
    html = report().html()
    for text in ("<b>tcn", "<on>", "<h1>A <page>", "a<b>"):
        assert text not in html
    for text in (
        "&lt;b&gt;tcn&lt;/b&gt;",
        "one &amp; so &lt;on&gt;",
        "A &lt;page&gt;",
        "&#39;a&lt;b&gt;&#39;",
    ):
        assert text in html


def test_the_page_refers_to_nothing_outside() -> None:
    html = report().html()
    for text in ("http:", "https:", "@import", "<script", "<link"):
        assert text not in html
    assert html.count('src="data:image/svg+xml;base64,') == html.count("src=") == 2


@given(
    st.lists(st.lists(st.sampled_from([None, float("nan"), 1.0, "x"]), min_size=3, max_size=3), min_size=1)
)
def test_a_column_without_values_is_left_out(cells: list[list[float | str | None]]) -> None:
    head = Table(["method", "a", "b", "c"], [["psd", *row] for row in cells]).markdown().splitlines()[0]
    known = [any(row[n] in (1.0, "x") for row in cells) for n in range(3)]
    assert head.replace("|", "").split() == ["method", *compress("abc", known)]


def test_a_bar_in_a_cell_ends_no_column_of_a_markdown_table() -> None:
    lines = Table(["group", "|v|"], [["a|b", 1.0]]).markdown().splitlines()
    assert lines == [r"| group | \|v\| |", "| ----- | ----: |", r"| a\|b  |   1.0 |"]


def test_json_has_the_command_and_unrounded_numbers_by_section() -> None:
    data = json.loads(json.dumps(report().json(), allow_nan=False))
    assert data["command"] == "slipflow evaluate 'a<b>'"
    assert data["sections"]["one"]["tables"][0]["rows"][1] == {"method": "psd", "F1 < 90": 3.25}


def test_the_figures_in_the_markdown_file_are_written_next_to_it(tmp_path: Path) -> None:
    paths = report().write(tmp_path / "a" / "b", "found")
    markdown = (tmp_path / "a" / "b" / "found.md").read_text()
    figures = [path.name for path in paths if path.suffix == ".svg"]
    assert figures == ["found-one.svg", "found-two.svg"]
    assert all(f"]({name})" in markdown for name in figures)
    assert "</svg>" in paths[-1].read_text()


def test_a_folder_that_cannot_be_written_is_refused_before_the_measurement(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(EndpointError, match=r"file/out: cannot be written: "):
        check_output_folder(tmp_path / "file" / "out")
    with pytest.raises(EndpointError, match=r"xx: cannot be written: File name too long"):
        check_output_folder(tmp_path / ("x" * 300))
    check_output_folder(tmp_path / "old")
    assert [path.name for path in tmp_path.rglob("*")] == ["file"]


def test_an_error_in_writing_names_the_folder_and_the_fix(tmp_path: Path) -> None:
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with patch.object(Path, "write_text", side_effect=full), pytest.raises(EndpointError) as raised:
        report().write(tmp_path, "found")
    assert str(tmp_path) in str(raised.value)
    assert "No space left on device" in str(raised.value)
