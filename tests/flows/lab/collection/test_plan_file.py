from pathlib import Path

import pytest

from flows.lab.collection.arm_path import Surface
from flows.lab.collection.plan_file import SHIPPED, load_plan
from flows.lab.collection.stroke_plan import CollectionPlan, Limits, PathSettings
from operators import InputError, ParameterError

OWN = """
speeds = ["10mm/s", "0.02m/s"]
repeats = 2
label_delay = "70ms"
[[surfaces]]
shape = "sphere"
radius = "6cm"
pose = [0.4, 0, 0.1, 3.1416, 0.0, 0.0]
[path]
depth = "2mm"
acceleration = 1
[limits]
workspace = [0.3, -0.1, 0.0, 0.5, 0.1, 0.2]
require_contact = false
"""


def written(folder: Path, text: str) -> str:
    path = folder / "mine.toml"
    path.write_text(text)
    return str(path)


def test_the_shipped_plans_can_be_read() -> None:
    assert list(SHIPPED) == ["paper", "tiny", "wide"]
    for name in SHIPPED:
        assert load_plan(name).name == name


def test_an_own_plan_overrides_the_defaults(tmp_path: Path) -> None:
    assert load_plan(written(tmp_path, OWN)) == CollectionPlan(
        name="mine",
        speeds=(0.01, 0.02),
        repeats=2,
        label_delay=70_000_000,
        surfaces=(Surface("sphere", 0.06, (0.4, 0.0, 0.1, 3.1416, 0.0, 0.0)),),
        path=PathSettings(depth=0.002, acceleration=1.0),
        limits=Limits(workspace=(0.3, -0.1, 0.0, 0.5, 0.1, 0.2), require_contact=False),
    )


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("speds = []", "unknown key speds; did you mean 'speeds'?"),
        ("[path]\nforce = '2N'", "unknown key path.force; known keys: depth"),
        ("speeds = ['fast']", "speeds[0] is 'fast', must be a speed with its unit"),
        ("speeds = [0.1]", "speeds[0] is 0.1, must be text with a unit"),
        ("speeds = ['500mm/s']", "speeds is (0.5,), must be above 0.003 m/s (slower is labelled static) "),
        ("speeds = ['3mm/s']", "speeds is (0.003,), must be above 0.003 m/s"),
        ("label_delay = '70s'", "label_delay is 70000000000, must be from 0 to 1000000000 ns"),
        ("speeds = []\nrotations = 0", "1 or more, or give rotations"),
        ("repeats = true", "repeats is True, must be a whole number"),
        ("repeats = 9223372036854775808", "repeats is 'too large', must be a number of at most 64 bits"),
        ("[path]\nacceleration = 0x" + "f" * 5000, "path.acceleration is 'too large', must be a number"),
        ("path = 3", "path is 3, must be a table, [path]"),
        ("[limits]\nworkspace = [1, 2]", "limits.workspace is [1, 2], must be a list of 6 values"),
        ("[[surfaces]]\nshape = 'cube'", "surfaces[0].shape is 'cube', must be one of plane, sphere"),
        ("[[surfaces]]\nradius = '50m'", "surfaces[0].radius is 50.0, must be from 0.001 to 1 m"),
        ("[[surfaces]]\n[[surfaces]]", "each with a different pose"),
        ("speeds = [", "is not valid TOML"),
        ("[path]\nacceleration = inf", "path.acceleration is inf, must be from 0.01 to 5 m/s2"),
        ("[path]\nrotation_speed = nan", "path.rotation_speed is nan, must be from 0.25 to 3 rad/s"),
        ("[path]\nclearance = '2mm'", "path.clearance is 0.002, must be from 0.003 to 0.5 m"),
        ("[path]\nbaseline = '0.5s'", "path.baseline is 0.5, must be from 1 to 600 s"),
        ("[path]\npress_speed = '1mm/s'", "path.press_speed is 0.001, must be from 0.002 to 0.3 m/s"),
        ("[path]\nrotation_time = '7s'", "path.rotation_time is 7.0, must be from 0.25 to 6.28 s"),
        ("[path]\nrotation_time = '200ms'", "path.rotation_time is 0.2, must be from 0.25 to 6.28 s"),
        ("rounds = 1_000_000_000_000", "rounds is 1000000000000, must be from 1 to 100"),
        ("[limits]\nsensor_timeout = '1d'", "limits.sensor_timeout is 86400.0, must be from 0.05 to 5 s"),
        ("[limits]\nworkspace = [-inf, -1, -1, 1, 1, 1]", "limits.workspace is -inf, must be from -10 to"),
        ("[[surfaces]]\npose = [nan, 0, 0, 3, 0, 0]", "surfaces[0].pose is nan, must be from -10 to 10"),
    ],
)
def test_a_mistake_names_the_file_and_the_key(tmp_path: Path, text: str, reason: str) -> None:
    path = written(tmp_path, text)
    mistaken = InputError if reason.startswith(("unknown key", "is not valid")) else ParameterError
    with pytest.raises(mistaken) as caught:
        load_plan(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unknown_plan_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"one of paper, tiny, wide, or a \.toml"):
        load_plan("grand")
    with pytest.raises(InputError, match="cannot be read"):
        load_plan(str(tmp_path / "none.toml"))
    (tmp_path / "latin.toml").write_bytes(b"name = '\xe9'")
    with pytest.raises(InputError, match="UTF-8"):
        load_plan(str(tmp_path / "latin.toml"))
