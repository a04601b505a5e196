import pytest

from connectors.sim.holding import least_force
from connectors.sim.objects import named
from flows.lab.experiments.trial_setting import SPREAD, Nature, Setting

BALL = named("ball")


def test_a_trial_is_the_same_for_every_method_and_differs_from_the_next() -> None:
    assert Setting.drawn(BALL, 5, Nature()) == Setting.drawn(BALL, 5, Nature())
    assert Setting.drawn(BALL, 5, Nature()).grip != Setting.drawn(BALL, 6, Nature()).grip


def test_mass_and_friction_spread_about_their_names() -> None:
    drawn = [Setting.drawn(BALL, seed, Nature()) for seed in range(200)]
    for values in ([each.mass for each in drawn], [each.friction for each in drawn]):
        assert 1 - SPREAD <= min(values) < 1 - 0.8 * SPREAD
        assert 1 + 0.8 * SPREAD < max(values) <= 1 + SPREAD


def test_a_hand_reckons_with_the_nominal_object_whatever_its_nature() -> None:
    nominal = Setting.drawn(BALL, 3, Nature())
    heavy = Setting.drawn(BALL, 3, Nature(friction=0.5, mass=2.0))
    assert heavy.least == pytest.approx(4 * nominal.least)
    assert heavy.expected == pytest.approx(nominal.expected)
    assert nominal.expected == pytest.approx(nominal.least)
    assert nominal.least == pytest.approx(
        least_force(BALL, friction=nominal.friction, mass=nominal.mass), rel=1e-12
    )
