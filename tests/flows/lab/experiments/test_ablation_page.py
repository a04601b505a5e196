import json
from collections.abc import Callable
from pathlib import Path

import pytest

from flows.lab.experiments import ablation_page
from flows.lab.experiments.lift_ablation import Ablation

Make = Callable[..., Ablation]


def test_the_page_says_what_breaks_first_and_what_is_lost_first(ablated: Make) -> None:
    text = ablation_page.text(ablated(firm=0.15, late="too late", late_lost=True, objects=("ball", "box")))
    assert (
        "psd, none: the ball breaks first, at +10 ms in 10 trials of each object, lost first: the ball"
        in text
    )
    assert "nothing breaks up to +100 ms in 10 trials of each object" in ablation_page.text(
        ablated(firm=0.15)
    )


def test_of_one_object_or_few_trials_nothing_is_said_to_break_first(ablated: Make) -> None:
    alone = ablated(firm=0.15, late="too late")
    few = ablated(firm=0.15, late="too late", objects=("ball", "box"), trials=9)
    assert "psd, none: the ball breaks at +10 ms in 10 trials" in ablation_page.text(alone)
    assert "psd, none: 9 trials of each object, too few to tell where it breaks" in ablation_page.text(few)
    for of in (alone, few):
        assert "first" not in ablation_page.text(of)
        assert ablation_page.summary(of)["methods"]["psd, none"]["breaks_first"] is None


def test_a_row_stands_for_each_condition(ablated: Make) -> None:
    text = ablation_page.text(ablated(firm=0.15, late="left behind"))
    rows = {
        line.split("|")[1].strip(): line.split("|")[2].strip() for line in text.splitlines() if "|" in line
    }
    assert (rows["+0 ms"], rows["+100 ms"], rows["50 Hz"], rows["lift x2"]) == ("100", "0", "100", "0")


def test_prediction_stands_beside_measurement(ablated: Make) -> None:
    lines = ablation_page.text(ablated(firm=0.15, late="left behind")).splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert ["ball", "150", "10", "300", "-", "380"] in cells


def test_a_program_reads_limits_conditions_and_budgets(ablated: Make) -> None:
    found = json.loads(
        json.dumps(
            ablation_page.summary(ablated(firm=0.15, late="left behind", objects=("ball", "box"))),
            allow_nan=False,
        )
    )
    method = found["methods"]["psd, none"]
    assert method["breaks_first"] == "ball"
    assert method["objects"]["ball"]["breaks_ms"] == pytest.approx(10)
    assert method["objects"]["ball"]["loses_ms"] is None
    assert method["conditions"]["lift x2"]["mean_success"] == 0
    assert found["budgets"]["ball"]["reach_mm"] == pytest.approx(24)


def test_it_is_written_with_its_figure(ablated: Make, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    paths = ablation_page.write(ablated(firm=0.15, late="left behind"), tmp_path, "slipflow experiment")
    assert sorted(path.name for path in paths) == [
        f"lift-ablation.{end}" for end in ("html", "json", "md", "svg")
    ]
    assert "added delay, ms" in (tmp_path / "lift-ablation.svg").read_text()
