from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.gripper.grip_force import ForceScale
from operators import ParameterError

MEASURED = ForceScale(((0, 12.0), (40, 30.0), (255, 65.0)))


@given(st.integers(0, 255), st.sampled_from([ForceScale(), MEASURED]))
def test_registers_and_forces_convert_both_ways(register: int, scale: ForceScale) -> None:
    assert scale.register(scale.force(register)) == register


@given(st.floats(15.0, 60.0))
def test_the_requested_force_is_at_most_one_step_below_the_wanted_one(force: float) -> None:
    scale = ForceScale()
    assert force - 0.1765 < scale.force(scale.register(force)) <= force + 1e-6


def test_forces_outside_the_scale_are_clipped() -> None:
    assert [MEASURED.register(force) for force in (-inf, 0.0, 11.0, 66.0, inf)] == [0, 0, 0, 255, 255]
    assert (MEASURED.weakest, MEASURED.strongest) == (12.0, 65.0)


def test_between_measured_points_it_is_linear() -> None:
    assert (MEASURED.force(20), MEASURED.register(21.0)) == (21.0, 20)


@pytest.mark.parametrize(
    "points",
    [
        (),
        ((0, 15.0),),
        ((1, 15.0), (255, 60.0)),
        ((0, 15.0), (254, 60.0)),
        ((0, 0.0), (255, 60.0)),
        ((0, 15.0), (255, inf)),
        ((0, 15.0), (255, nan)),
        ((0, 15.0), (100, 15.0), (255, 60.0)),
        ((0, 15.0), (100, 20.0), (100, 25.0), (255, 60.0)),
    ],
)
def test_points_that_are_no_scale_are_refused(points: tuple[tuple[int, float], ...]) -> None:
    with pytest.raises(ParameterError, match="ForceScale: points"):
        ForceScale(points)
