import pytest

from operators import InputError
from operators.detectors import DETECTORS, TRAINED


def test_detectors_that_need_no_weights_are_known_by_their_names() -> None:
    assert {name: make().name for name, make in DETECTORS.items()} == {name: name for name in DETECTORS}


def test_trained_detectors_have_names_and_report_missing_weights() -> None:
    assert {name: getattr(make, "name", None) for name, make in TRAINED.items()} == {
        name: name for name in TRAINED
    }
    for make in TRAINED.values():
        with pytest.raises(InputError, match="is missing"):
            make({})
