import json

from operators.detectors import DETECTORS
from storage.models import PURPOSES, shipped_names
from tests.command import slipflow


def test_every_detector_has_a_purpose() -> None:
    assert set(PURPOSES) == {*DETECTORS, *shipped_names()}


def test_models_lists_what_each_detector_is_meant_for() -> None:
    lines = slipflow("models").stdout.splitlines()
    assert [line.split()[:2] for line in lines] == [[name, each.task] for name, each in PURPOSES.items()]
    found = {each["name"]: each for each in json.loads(slipflow("models", "--json").stdout)["models"]}
    assert (found["tcn"]["task"], found["tcn_grasp"]["task"]) == ("strokes", "grasps")
    assert 50 < found["tcn"]["balanced_test"] < 100
    assert (found["psd"]["path"], found["psd"]["balanced_test"]) == (None, None)
