import pytest

from flows.lab.simulation import PLANS
from operators.errors import ParameterError
from tests.scene.scene_measured import Size


def test_the_papers_plan_is_measured_thoroughly_and_others_hastily() -> None:
    whole, hasty = Size.of("paper"), Size.of("tiny")
    assert (whole, hasty.plan) == (Size(), PLANS["tiny"])
    assert set(hasty.terms) < set(whole.terms)
    assert hasty.timed < whole.timed


def test_an_unknown_plan_is_refused() -> None:
    with pytest.raises(ParameterError, match="plan is 'huge', must be one of paper, wide, tiny"):
        Size.of("huge")
