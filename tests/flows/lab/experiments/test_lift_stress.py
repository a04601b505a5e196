from pathlib import Path

from flows.lab.experiments import lift_stress_page as stress_page
from flows.lab.experiments.experiment import Method
from flows.lab.experiments.lift_stress import NOMINAL, grid, stress
from flows.lab.experiments.trial_setting import Conditions


def test_each_condition_differs_from_nominal_in_one_thing() -> None:
    nominal = Conditions()
    tried = grid(nominal)
    assert tried[NOMINAL] == nominal
    for name, each in tried.items():
        parts = (each.hand != nominal.hand, each.nature != nominal.nature, each.rate != nominal.rate)
        assert sum(parts) == (name != NOMINAL)
    assert len(set(map(repr, tried.values()))) == len(tried)


def test_what_is_named_is_what_is_done() -> None:
    tried = grid(Conditions())
    assert tried["delay +50 ms"].hand.delay == 0.05
    assert tried["friction x0.5"].nature.friction == 0.5
    assert tried["mass x2"].nature.mass == 2.0
    assert tried["50 Hz"].rate == 50.0
    assert tried["cell 1 dead"].nature.dead == (1,)


def test_the_table_has_a_row_for_each_condition(tmp_path: Path) -> None:
    seen: list[tuple[int, int, str]] = []
    found = stress(
        Method("psd", "none"),
        trials=1,
        objects=["ball"],
        jobs=1,
        progress=lambda done, of, part: seen.append((done, of, part)),
    )
    names = list(grid(Conditions()))
    assert list(found.found) == names
    assert seen[-1] == (len(names), len(names), names[-1])
    assert set(found.json()["conditions"]) == set(names)
    text = stress_page.text(found)
    assert all(f"| {name} " in text for name in names)
    paths = stress_page.write(found, tmp_path, "slipflow experiment lift --stress")
    assert [path.name for path in paths] == ["lift-stress.html", "lift-stress.md", "lift-stress.json"]
