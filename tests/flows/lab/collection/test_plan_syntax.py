import pytest

from flows.lab.collection.plan_syntax import box, curvature, speeds, surface
from flows.lab.collection.surfaces import Spot
from operators.errors import ParameterError


def test_a_surface_is_a_name_a_radius_and_a_place() -> None:
    assert surface("plane") == Spot("plane")
    assert surface("sphere:60mm") == surface("sphere:0.06") == Spot("sphere", radius=0.06)
    assert surface("cylinder_x@1,2,3,4,5,6").place == (1, 2, 3, 4, 5, 6)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("cube", "--surface is 'cube', must be one of plane, sphere, cylinder_x, cylinder_y"),
        ("plane:5mm", "--surface is 'plane:5mm', must be without a radius for a plane"),
        ("sphere:big", "the radius in --surface is 'big', must be a length with its unit"),
        ("sphere@1,2", "--surface is '1,2', must be 6 numbers with commas between"),
    ],
)
def test_what_is_no_surface_is_told(text: str, why: str) -> None:
    with pytest.raises(ParameterError, match=f"collect: {why}"):
        surface(text)


def test_a_curvature_is_told_of_by_its_command() -> None:
    with pytest.raises(ParameterError, match="rig: --surface is 'cube'"):
        curvature("cube", "rig")


def test_corners_are_six_numbers() -> None:
    assert box("0,0,0,1,1,2") == ((0, 0, 0), (1, 1, 2))
    with pytest.raises(ParameterError, match="--workspace is '1', must be 6 numbers"):
        box("1")


@pytest.mark.parametrize("text", ["", "a", "10mm/s,", "0.01,0.02"])
def test_what_are_no_speeds_is_told(text: str) -> None:
    with pytest.raises(ParameterError, match=r"--speeds is .* must be a speed with its unit: 3mm/s"):
        speeds(text)
