from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest

from connectors.sim.grasp import least_force
from connectors.sim.objects import named
from flows.lab.experiments.trial import SPREAD, Conditions, Trace, Trial
from operators import Grip, ParameterError
from operators.batch import Reals

BALL = named("ball")


@pytest.mark.parametrize("name", ["rate", "repeat", "friction", "mass", "grip", "pace"])
def test_a_condition_that_is_not_positive_is_refused(name: str) -> None:
    with pytest.raises(ParameterError, match=name):
        Conditions(**cast("Any", {name: 0}))


def test_a_seed_draws_the_same_trial_and_the_next_seed_another() -> None:
    first, again, other = (Trial.draw(BALL, seed, Conditions()) for seed in (5, 5, 6))
    assert first == again
    assert first.position != other.position


def test_mass_and_friction_vary_by_ten_percent() -> None:
    drawn = [Trial.draw(BALL, seed, Conditions()) for seed in range(200)]
    for values in ([trial.mass for trial in drawn], [trial.friction for trial in drawn]):
        assert 1 - SPREAD <= min(values) < 1 - 0.8 * SPREAD
        assert 1 + 0.8 * SPREAD < max(values) <= 1 + SPREAD


def test_the_expected_force_assumes_nominal_friction_and_mass() -> None:
    nominal = Trial.draw(BALL, 3, Conditions())
    heavy = Trial.draw(BALL, 3, Conditions(friction=0.5, mass=2.0))
    assert heavy.least_force == pytest.approx(4 * nominal.least_force)
    assert heavy.expected_force == pytest.approx(nominal.expected_force)
    assert nominal.expected_force == pytest.approx(nominal.least_force)
    assert nominal.least_force == pytest.approx(
        least_force(BALL, friction=nominal.friction, mass=nominal.mass), rel=1e-12
    )


def test_a_slip_is_registered_after_enough_consecutive_scores(make_trace: Callable[..., Trace]) -> None:
    probability = np.zeros(600)
    probability[:8] = [0.9, 0.9, 0.9, 0.1, 0.9, np.nan, 0.9, 0.9]
    trace = make_trace(probability=probability)
    assert np.flatnonzero(trace.registered(Grip(threshold=0.5, consecutive=2))).tolist() == [1, 2, 7]
    assert np.flatnonzero(trace.registered(Grip(threshold=0.5, consecutive=1))).tolist() == [0, 1, 2, 4, 6, 7]


def test_each_slip_has_one_onset(make_trace: Callable[..., Trace], during: Callable[..., Reals]) -> None:
    trace = make_trace(probability=during((2.0, 2.5), (3.0, 3.01), (4.0, 4.02)))
    assert trace.onsets(Grip(threshold=0.5, consecutive=2)).tolist() == [2.01, 4.01]
