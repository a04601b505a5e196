import json
from pathlib import Path

import pytest

from flows.experiment import page
from flows.experiment.experiment import Found, Kind, Method
from flows.experiment.lifting import Lifting
from flows.experiment.setting import Conditions
from flows.experiment.tapping import Tapping

OBJECTS = ("ball", "box")


def _found(kind: Kind) -> Found:
    held = Lifting("held", 3.0, 20.0, 1.5, 1.75, 0)
    missed = Lifting("missed", 30.0, float("nan"), float("nan"), 0.5, 1)
    felt = Tapping("felt", "top", 2.0, 30.0, 1, 0, 0, 0)
    late = Tapping("too late", "side", 4.0, 300.0, 3, 1, 1, 0)
    good, bad = (held, missed) if kind == "lift" else (felt, late)
    outcomes = {
        ("psd, ours", "ball"): [good, bad],
        ("psd, ours", "box"): [good, good],
        ("psd, none", "ball"): [bad, bad],
        ("psd, none", "box"): [bad, bad],
    }
    return Found(
        kind, 2, 7, Conditions(), outcomes, ("psd, ours", "psd, none"), OBJECTS, Method("psd", "ours")
    )


def test_the_papers_table_stands_beside_ours() -> None:
    text = page.text(_found("lift"))
    assert (
        "psd, ours holds in 3 of 4 trials, 2 of each object (75.0 %); the paper in 67.5 % of its own" in text
    )
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines()]
    assert ["psd, ours", "50", "100", "75.0"] in cells
    assert ["psd, none", "0", "0", "0.0"] in cells
    assert ["paper, real objects", "35", "100", "67.5"] in cells


def test_failures_are_counted_by_how() -> None:
    section = page.failures(_found("tap"))
    [table] = section.tables
    assert section.title == "psd, ours fails in 1 of 4 trials, mostly by: too late"
    assert table.rows[0] == ["psd, ours", "ball", "1 too late"]
    assert all(row[:2] != ["psd, ours", "box"] for row in table.rows)


def test_a_program_reads_mean_success_each_object_and_the_failures() -> None:
    summary = json.loads(json.dumps(page.summary(_found("lift")), allow_nan=False))
    assert summary["mean_success"] == 75.0
    assert summary["objects"] == {"ball": 50.0, "box": 100.0}
    assert summary["failures"] == {"missed": 1}
    ours = summary["methods"]["psd, ours"]
    assert ours["slide_mm"] == 3.0
    assert ours["force_ratio"] == 1.5
    assert summary["methods"]["psd, none"]["force_ratio"] is None


def test_false_slips_are_told_as_shares_of_trials() -> None:
    numbers = page.numbers(_found("tap"), "psd, ours")
    assert (numbers["false_lift"], numbers["false_tap"]) == (25.0, 25.0)


@pytest.mark.parametrize("kind", ["tap", "lift"])
def test_a_page_is_written_with_the_figure_of_a_trial(kind: Kind, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    paths = page.write(_found(kind), tmp_path, "slipflow experiment")
    assert sorted(path.name for path in paths) == [f"{kind}.{end}" for end in ("html", "json", "md", "svg")]
    assert "least that holds" in (tmp_path / f"{kind}.svg").read_text()
