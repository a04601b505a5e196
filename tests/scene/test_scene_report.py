"""The scene study on a tiny plan: all sections are there, with the computed numbers."""

import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from connectors.sim.paper_plan import PaperPlan
from flows.lab.simulation import PLANS
from flows.learn.evaluation.motion_metrics import MotionKind
from flows.learn.labelled_recordings import LabelledRecording, simulated_recordings
from operators.errors import EndpointError, InputError, ParameterError
from tests.scene.__main__ import main, write_scene
from tests.scene.scene_judges import by_motion, confusion, fit
from tests.scene.scene_measurements import Size
from tests.scene.scene_statistics import TABLE, distance, measure

SECTIONS = ("traces", "realism", "statistics", "ablation", "motion", "speed")
SHARED = Path(__file__).parents[3] / "shared" / "real"
TINY = PaperPlan(surfaces=("plane", "sphere"), speeds=(0.05,), repeats=1, rotations=1, rounds=1)
SIZE = Size(TINY, TINY, seeds=2, hop=10, terms=("texture", "6 x 4 nodes"), timed=0.5, draws=10)


@dataclass(frozen=True)
class Written:
    folder: Path
    page: str
    log: list[str]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    """The study of a tiny plan without real data."""
    pytest.importorskip("matplotlib")
    folder, log = tmp_path_factory.mktemp("docs"), list[str]()
    path = write_scene(folder, size=SIZE, log=log.append)
    return Written(folder, path.read_text(), log)


@pytest.fixture(scope="module")
def recordings() -> list[LabelledRecording]:
    return simulated_recordings(TINY, 0)


def cells(page: str, row: str) -> list[str]:
    """Return the cells after the first one of the first table row that begins with this text."""
    [line, *_] = [line for line in page.splitlines() if re.match(rf"\| +{re.escape(row)} +\|", line)]
    return [cell.strip() for cell in line.strip("| ").split("|")][1:]


def test_every_section_has_a_finding_and_a_figure(written: Written) -> None:
    assert written.page.count("\n## ") == len(SECTIONS)
    assert written.page.endswith("\n    python -m tests.scene --seed 0\n")
    for name in SECTIONS:
        assert f"](../figures/scene-{name}.svg)" in written.page


def test_every_figure_is_an_svg_with_paths(written: Written) -> None:
    for name in SECTIONS:
        root = ET.parse(written.folder / "figures" / f"scene-{name}.svg").getroot()  # noqa: S314 - ours
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert len(list(root.iter("{http://www.w3.org/2000/svg}path"))) > 3


def test_sections_without_their_file_say_that_they_are_skipped(written: Written) -> None:
    assert [text for text in written.log if text.startswith("SKIPPED")] == [
        "SKIPPED: paper's TCN, because --judge was not given",
        "SKIPPED: the real trace, because --trace was not given",
    ]
    assert written.page.count("**Skipped: the paper's TCN, because no `--judge` was given.**") == 3
    assert written.page.count("**Skipped: the real trace, because no `--trace` was given.**") == 3


def test_the_tables_hold_the_computed_numbers(written: Written, recordings: list[LabelledRecording]) -> None:
    found = measure(recordings)
    for row in TABLE:
        if not row.text.startswith("the same"):
            shown = [float(value) for value in cells(written.page, row.text)[0].split(",")]
            assert shown == pytest.approx(found[row.key], rel=5e-3, abs=5e-3, nan_ok=True), row.key
    assert f"**{distance(found):.2f}**" in written.page

    _, logistic = fit(simulated_recordings(TINY, 500), SIZE.hop)
    motions = by_motion(logistic, recordings, SIZE.hop)
    first, second = (motions.at(MotionKind("primary", 0.05, surface)).f1 for surface in ("plane", "sphere"))
    assert [text.split()[0] for text in cells(written.page, "primary, 5 cm/s")[:2]] == [
        f"{first:.1f}",
        f"{second:.1f}",
    ]
    balanced = confusion(logistic, recordings, SIZE.hop).balanced
    assert cells(written.page, "logistic regression") == [f"{balanced:.1f}"]


def test_with_real_data_the_report_holds_its_scores(tmp_path: Path) -> None:
    judge, trace = SHARED / "paper_tcn.npz", SHARED / "mat_trace.csv"
    if not (judge.exists() and trace.exists()):
        pytest.skip(f"SKIPPED: no real data in {SHARED}")
    brief = replace(SIZE, hop=40, terms=SIZE.terms[:1])
    page = write_scene(tmp_path, judge=judge, trace=trace, size=brief).read_text()
    assert "Skipped" not in page
    # the paper's TCN on the trace: 70.4 % balanced, accuracy 0.687, as with its authors' code
    assert cells(page, "paper's TCN")[2:] == ["70.4", "75.5", "65.2"]
    assert re.search(r"\n## A network trained on real data is right on \d\d\.\d % of the simulation", page)
    assert str(SHARED) not in page


def test_the_paper_plan_is_measured_in_full_and_others_briefly() -> None:
    full, brief = Size.of("paper"), Size.of("tiny")
    assert (full, brief.plan) == (Size(), PLANS["tiny"])
    assert set(brief.terms) < set(full.terms)
    assert brief.timed < full.timed
    with pytest.raises(ParameterError, match="plan is 'huge', must be one of paper, wide, slow, tiny"):
        Size.of("huge")


def test_the_command_documents_its_options(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["scene", "--help"])
    with pytest.raises(SystemExit):
        main()
    text = capsys.readouterr().out
    assert all(option in text for option in ("--seed", "--judge", "--trace", "--out", "--plan"))


def test_without_matplotlib_it_says_what_to_install_before_it_measures(
    tmp_path: Path, hide_packages: Callable[..., None]
) -> None:
    hide_packages("matplotlib")
    with pytest.raises(InputError, match=re.escape("pip install -e '.[report]'")):
        write_scene(tmp_path, log=pytest.fail)


def test_a_folder_that_cannot_be_created_is_an_error_before_anything_is_measured(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(EndpointError, match=r"file/x/explanations: cannot be created: "):
        write_scene(tmp_path / "file" / "x", log=pytest.fail)
