from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import pytest

from connectors.sim.paper_plan import PaperPlan
from connectors.sim.scene import PaperStrokes
from flows.learn.evaluation import evaluation_figures, stress_study
from flows.learn.evaluation.evaluation_report import stress_report
from flows.learn.evaluation.evaluation_study import Evaluation
from flows.learn.evaluation.methods import FittedMethod
from flows.learn.evaluation.stress_study import FIELDS, NOMINAL, condition_name, every_condition, stress
from flows.learn.measures import BALANCED
from flows.report.results import estimates
from operators import Debounce
from operators.detectors import Psd
from operators.errors import FingertipError
from operators.fingertip import TAKKTILE

TINY = PaperPlan(surfaces=("plane",), speeds=(0.05,), repeats=1, rotations=0, strokes=PaperStrokes(rounds=1))
SEED = 7


@pytest.fixture(scope="module")
def found() -> Iterator[Evaluation]:
    """The performance along four fields, which are the only ones meanwhile."""
    few = {name: FIELDS[name] for name in ("dead", "clock", "friction", "slip_speed")}
    with patch.object(stress_study, "FIELDS", few), patch.object(evaluation_figures, "FIELDS", few):
        yield stress(names=["psd"], seed=SEED, plan=TINY, training=TINY)


def test_a_model_for_another_fingertip_is_refused_before_the_simulation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fast = FittedMethod("fast", Psd(fingertip=replace(TAKKTILE, rate=200.0)), Debounce())
    monkeypatch.setattr(stress_study, "trained_methods", lambda _: [fast])
    with pytest.raises(FingertipError, match="psd needs 200 Hz"):
        stress()


def test_every_value_of_every_field_is_judged(found: Evaluation) -> None:
    names = [condition_name(field, value) for field, value in every_condition()]
    assert found.results["condition"].unique(maintain_order=True).to_list() == list(dict.fromkeys(names))
    assert names.count(NOMINAL) == 3, "slip speed has a plan of its own"
    assert found.methods["psd"].chosen_on == "validation"


def test_the_report_has_a_row_for_each_level_and_a_panel_for_each_field(
    found: Evaluation, tmp_path: Path
) -> None:
    report = stress_report(found, "slipflow evaluate --stress")
    paths = report.write(tmp_path, "stress")
    assert [path.name for path in paths] == ["stress.html", "stress.md", "stress.json", "stress.svg"]
    levels, events = (section.tables[0] for section in report.sections if section.tables)
    assert levels.head == ["stress", "level", "psd"]
    assert events.head[2:4] == ["balanced %", "events/min"]
    assert len(levels.rows) == len(events.rows) == len(every_condition()) - 4 + 2
    assert ["slip speed", "10 mm/s"] in [row[:2] for row in levels.rows]
    figure = evaluation_figures.stress_panels(estimates(found.results, BALANCED, ("condition", "method")))
    titles = [axis.get_title().partition(",")[0] for axis in figure.axes]
    assert [title for title in titles if title] == [FIELDS[field].text for field in dict(every_condition())]
