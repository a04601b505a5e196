from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from connectors.sim.objects import named
from flows.lab.experiments.lifting import LIFT, lift, raised, weak
from flows.lab.experiments.tapping import Nothing
from flows.lab.experiments.trial import BASELINE
from flows.lab.experiments.trial_setting import Conditions, Nature, Setting
from operators import Grip, ParameterError
from storage import load_detector

BALL = named("ball")


def test_however_slow_the_rate_is_the_hand_has_closed_before_it_goes_up() -> None:
    detector = load_detector("tcn_grasp")
    for rate in (10.0, 25.0):
        trace, _ = lift(BALL, 1, (detector, Grip()), Conditions(rate=rate))
        assert trace.force[trace.between(BASELINE + 0.3, LIFT.instant)].min() > 0
        assert np.diff(trace.t[trace.between(BASELINE, 6)]) == pytest.approx(1 / rate)


def test_a_reading_that_is_held_is_repeated_until_the_next() -> None:
    trace, _ = lift(BALL, 1, (Nothing(), Grip()), Conditions(every=4))
    counts = trace.counts[trace.between(BASELINE, 6)]
    groups = counts.reshape(-1, 4, 6)
    assert (groups == groups[:, :1]).all()
    assert (np.diff(groups[:, 0], axis=0) != 0).any()


def test_a_lift_is_as_weak_and_as_quick_as_its_conditions_say() -> None:
    setting = Setting.drawn(BALL, 1, Nature())
    assert weak(setting, Conditions(weak=0.5)) == pytest.approx(weak(setting, Conditions()) / 2)
    quick = raised(Conditions(pace=2.0))
    assert (quick.speed, quick.height) == (2 * LIFT.speed, LIFT.height)
    assert quick.end < LIFT.end


@pytest.mark.parametrize("name", ["rate", "every", "weak", "pace"])
def test_a_condition_that_cannot_be_is_refused(name: str) -> None:
    with pytest.raises(ParameterError, match=name):
        replace(Conditions(), **cast("Any", {name: 0}))
