"""The scene's report on a tiny plan: all of it is there, its numbers are those computed, gaps are named."""

import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from connectors.sim.paper_plan import Collection
from flows.learn.evaluation.motion_metrics import Cell
from flows.learn.labelled_recordings import LabelledRecording, simulated_recordings
from flows.report import figures
from operators.errors import EndpointError, InputError
from tests.scene.scene_judges import cells as judged_cells
from tests.scene.scene_judges import confusion, fitted
from tests.scene.scene_measured import Size
from tests.scene.scene_report import SECTIONS, write_report
from tests.scene.scene_statistics import TABLE, distance, measure

SHARED = Path(__file__).parents[3] / "shared" / "real"
TINY = Collection(surfaces=("plane", "sphere"), speeds=(0.05,), repeats=1, rotations=1, rounds=1)
SIZE = Size(TINY, TINY, seeds=2, hop=10, terms=("texture", "6 x 4 nodes"), timed=0.5)


@dataclass(frozen=True)
class Written:
    folder: Path
    page: str
    told: list[str]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    """The report of a tiny plan without real data."""
    folder, told = tmp_path_factory.mktemp("docs"), list[str]()
    path = write_report(folder, size=SIZE, told=told.append)
    return Written(folder, path.read_text(), told)


@pytest.fixture(scope="module")
def trials() -> list[LabelledRecording]:
    return simulated_recordings(TINY, 0)


def cells(page: str, row: str) -> list[str]:
    """The cells of the first table row that begins with this text, after it."""
    [line, *_] = [line for line in page.splitlines() if line.startswith(f"| {row} |")]
    return [cell.strip() for cell in line.strip("| ").split("|")][1:]


def test_every_section_has_a_title_a_figure_and_its_command(written: Written) -> None:
    assert written.page.count("\n## ") == len(SECTIONS)
    assert written.page.count("\n    slipflow simulate --report docs") == len(SECTIONS)
    for name in SECTIONS:
        assert f"![{name}](figures/scene-{name}.svg)" in written.page


def test_every_figure_is_an_svg_with_something_drawn(written: Written) -> None:
    for name in SECTIONS:
        root = ET.parse(written.folder / "figures" / f"scene-{name}.svg").getroot()  # noqa: S314 - ours
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert len(list(root.iter("{http://www.w3.org/2000/svg}path"))) > 3


def test_what_needs_a_file_that_was_not_given_is_skipped_loudly(written: Written) -> None:
    assert [text for text in written.told if text.startswith("SKIPPED")] == [
        "SKIPPED: paper's TCN, because --judge was not given",
        "SKIPPED: the real trace, because --trace was not given",
    ]
    assert written.page.count("**Skipped: the paper's TCN, because no `--judge` was given.**") == 3
    assert written.page.count("**Skipped: the real trace, because no `--trace` was given.**") == 2


def test_the_numbers_of_the_tables_are_those_computed(
    written: Written, trials: list[LabelledRecording]
) -> None:
    found = measure(trials)
    for row in TABLE:
        if not row.text.startswith("the same"):
            shown = [float(value) for value in cells(written.page, row.text)[0].split(",")]
            assert shown == pytest.approx(found[row.key], rel=5e-3, abs=5e-3, nan_ok=True), row.key
    assert f"**{distance(found):.2f}**" in written.page

    _, logistic = fitted(simulated_recordings(TINY, 500), SIZE.hop)
    judged = judged_cells(logistic, trials, SIZE.hop)
    first, second = (judged.at(Cell("primary", 0.05, surface)).f1 for surface in ("plane", "sphere"))
    assert [text.split()[0] for text in cells(written.page, "primary, 5 cm/s")[:2]] == [
        f"{first:.1f}",
        f"{second:.1f}",
    ]
    assert f"logistic regression {confusion(logistic, trials, SIZE.hop).balanced:.1f} %" in written.page


def test_with_real_data_the_judgement_stands_in_the_report(tmp_path: Path) -> None:
    judge, trace = SHARED / "paper_tcn.npz", SHARED / "mat_trace.csv"
    if not (judge.exists() and trace.exists()):
        pytest.skip(f"SKIPPED: no real data in {SHARED}")
    page = write_report(tmp_path, judge=judge, trace=trace, size=SIZE).read_text()
    assert "Skipped" not in page
    # the paper's TCN on the trace: 70.4 % balanced, .687 accuracy as its authors' code gives
    assert cells(page, "paper's TCN")[2:] == ["70.4", "75.5", "65.2"]
    assert re.search(r"\n## A network trained on real data is right on \d\d\.\d % of the simulation", page)
    assert str(SHARED) not in page


def test_without_matplotlib_it_says_what_to_install_before_it_measures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> None:
        del name

    monkeypatch.setattr(figures, "find_spec", missing)
    with pytest.raises(InputError, match=re.escape("pip install -e '.[report]'")):
        write_report(tmp_path, told=pytest.fail)


def test_a_folder_that_cannot_be_made_is_told_before_anything_is_measured(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(
        EndpointError, match=r"file/x: cannot be made: .*; a file exists where a folder is needed"
    ):
        write_report(tmp_path / "file" / "x", told=pytest.fail)
