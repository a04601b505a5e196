import json
from collections.abc import Callable
from pathlib import Path

import pytest

from flows.lab.experiments.ablation_report import ablation_report
from flows.lab.experiments.lift_ablation import Ablation

Make = Callable[..., Ablation]


def text(found: Ablation) -> str:
    return ablation_report(found, "slipflow experiment lift --ablation").terminal()


def test_the_report_names_the_object_that_breaks_first_and_the_one_lost_first(make_ablation: Make) -> None:
    several = make_ablation(firm=0.15, late="too late", late_lost=True, objects=("ball", "box"))
    first = "psd, none: the ball breaks first, at +10 ms in 10 trials of each object, lost first: the ball"
    assert first in text(several)
    assert "nothing breaks up to +100 ms in 10 trials of each object" in text(make_ablation(firm=0.15))


def test_one_object_or_few_trials_are_not_ranked(make_ablation: Make) -> None:
    alone = make_ablation(firm=0.15, late="too late")
    few = make_ablation(firm=0.15, late="too late", objects=("ball", "box"), trials=9)
    assert "psd, none: the ball breaks at +10 ms in 10 trials" in text(alone)
    assert "psd, none: 9 trials of each object, too few to find where it breaks" in text(few)
    for found in (alone, few):
        assert "first" not in text(found)
        assert ablation_report(found, "").json()["breaks_first"] == {"psd, none": None}


def test_json_has_conditions_limits_and_budgets(make_ablation: Make) -> None:
    report = ablation_report(make_ablation(firm=0.15, late="not lifted", objects=("ball", "box")), "")
    found = json.loads(json.dumps(report.json(), allow_nan=False))
    assert found["breaks_first"] == {"psd, none": "ball"}
    sections = {name: section["tables"][0]["rows"] for name, section in found["sections"].items()}
    assert [(row["condition"], row["ball"]) for row in sections["lift-ablation"]] == [
        ("+0 ms", 100),
        ("+100 ms", 0),
    ]
    assert sections["rates"][0]["condition"] == "50 Hz"
    assert (sections["hard"][0]["condition"], sections["hard"][0]["mean"]) == ("lift x2", 0)
    assert sections["limits"][0] == {
        "object": "ball",
        "firm ms": 150,
        "breaks ms": pytest.approx(10),
        "predicted ms": pytest.approx(300, abs=1),
        "lost ms": None,
        "predicted loss ms": pytest.approx(380, abs=1),
    }
    assert (sections["budgets"][0]["reach mm"], sections["budgets"][0]["table ms"]) == (24, 450)


def test_a_report_is_written_with_its_figure(make_ablation: Make, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    report = ablation_report(make_ablation(firm=0.15, late="not lifted"), "slipflow experiment")
    paths = report.write(tmp_path, "lift-ablation")
    assert [path.name for path in paths] == [f"lift-ablation.{end}" for end in ("html", "md", "json", "svg")]
    assert "added delay, ms" in (tmp_path / "lift-ablation.svg").read_text()
