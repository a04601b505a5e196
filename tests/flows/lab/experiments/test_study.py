from dataclasses import fields, replace

import pytest

from flows.lab.experiments import study
from flows.lab.experiments.study import NOMINAL, SEED, Method, Trials, conditions_of, run_study
from flows.lab.experiments.trial import Conditions
from flows.run.executor import workers
from operators.detectors import Psd
from operators.errors import FingertipError
from operators.fingertip import TAKKTILE

NONE = Method("psd", "none")


def test_each_condition_differs_from_nominal_in_one_setting_and_only_a_lift_has_a_delay() -> None:
    nominal, *varied = conditions_of("lift", stress=True).items()
    assert nominal == (NOMINAL, Conditions())
    for name, condition in varied:
        changed = {
            each.name: getattr(condition, each.name)
            for each in fields(condition)
            if getattr(condition, each.name) != getattr(Conditions(), each.name)
        }
        assert [f"{setting} {value:g}" for setting, value in changed.items()] == [name]
    taps = [name for name, _ in varied if not name.startswith("delay ")]
    assert [*conditions_of("tap", stress=True)] == [NOMINAL, *taps]
    assert [*conditions_of("tap", stress=False)] == [NOMINAL]


def test_a_model_for_another_fingertip_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    fast = Psd(fingertip=replace(TAKKTILE, rate=200.0))
    monkeypatch.setattr(study, "load_detector", lambda _: fast)
    with pytest.raises(FingertipError, match=r"psd needs 200 Hz; the data has .*100 Hz"):
        NONE.load()


def test_processes_and_the_number_of_trials_change_no_trial() -> None:
    seen: list[tuple[int, int]] = []
    two = run_study("lift", [NONE], Trials(2, objects=("ball",)))
    with workers(2) as executor:
        again = run_study(
            "lift",
            [NONE],
            Trials(1, objects=("box", "ball")),
            executor=executor,
            progress=lambda done, total: seen.append((done, total)),
        )
    assert again.filter(fold="ball").equals(two.filter(recording=f"ball-{SEED}"))
    assert seen == [(0, 2), (1, 2), (2, 2)]
