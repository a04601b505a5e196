import json
from collections.abc import Callable
from pathlib import Path

import pytest

from flows.lab.experiments import experiment_page as page
from flows.lab.experiments.experiment import Found, Kind


def test_the_papers_table_stands_beside_ours(found: Callable[[Kind], Found]) -> None:
    text = page.text(found("lift"))
    assert (
        "psd, ours holds in 3 of 4 trials, 2 of each object (75.0 %); the paper in 67.5 % of its own" in text
    )
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines()]
    assert ["psd, ours", "50", "100", "75.0"] in cells
    assert ["psd, none", "0", "0", "0.0"] in cells
    assert ["paper, real objects", "35", "100", "67.5"] in cells


def test_a_program_reads_mean_success_each_object_and_the_failures(found: Callable[[Kind], Found]) -> None:
    summary = json.loads(json.dumps(page.summary(found("lift")), allow_nan=False))
    assert summary["mean_success"] == 75.0
    assert summary["objects"] == {"ball": 50.0, "box": 100.0}
    assert summary["failures"] == {"missed": 1}
    ours = summary["methods"]["psd, ours"]
    assert ours["slide_mm"] == 3.0
    assert ours["force_ratio"] == 1.5
    assert summary["methods"]["psd, none"]["force_ratio"] is None


@pytest.mark.parametrize("kind", ["tap", "lift"])
def test_a_page_is_written_with_the_figure_of_a_trial(
    found: Callable[[Kind], Found], kind: Kind, tmp_path: Path
) -> None:
    pytest.importorskip("matplotlib")
    paths = page.write(found(kind), tmp_path, "slipflow experiment")
    assert sorted(path.name for path in paths) == [f"{kind}.{end}" for end in ("html", "json", "md", "svg")]
    assert "least that holds" in (tmp_path / f"{kind}.svg").read_text()
