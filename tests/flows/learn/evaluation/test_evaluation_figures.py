from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from flows.learn.evaluation import evaluation_figures as figures
from flows.learn.evaluation.evaluation_study import Evaluation
from flows.report.figures import Figure, save


@pytest.mark.parametrize("name", ["confusions", "curves", "delays", "changes"])
def test_every_figure_names_every_method(name: str, found: Evaluation, tmp_path: Path) -> None:
    drawn: Figure = getattr(figures, name)(found.results)
    path = tmp_path / "figure.svg"
    save(drawn, path)
    text = "".join(ET.parse(path).getroot().itertext())  # noqa: S314 - ours
    for result in found.results:
        assert result.method.name in text


def test_confusions_take_as_many_rows_as_they_need(found: Evaluation) -> None:
    drawn = figures.confusions(found.results * 4)
    assert len([axis for axis in drawn.axes if axis.get_title()]) == 0  # titles are aligned left
    assert len([axis for axis in drawn.axes if axis.axison]) == 12


def test_motions_have_a_panel_for_each_surface(found: Evaluation) -> None:
    drawn = figures.motion({result.method.name: result.motions for result in found.results[:2]})
    titles = [axis.get_title(loc="left") for axis in drawn.axes]
    assert titles == ["plane", "sphere", "cylinder y", "cylinder x"]
