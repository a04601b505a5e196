import pytest

import operators
from operators import InputError, detectors
from operators.detectors import DETECTORS, TRAINED


def test_every_public_name_is_there_and_named_once() -> None:
    for module in (operators, detectors):
        assert all(hasattr(module, name) for name in module.__all__)
        assert len(set(module.__all__)) == len(module.__all__)


def test_detectors_that_need_no_weights_are_known_by_their_names() -> None:
    assert {name: make().name for name, make in DETECTORS.items()} == {name: name for name in DETECTORS}


def test_trained_detectors_have_names_and_report_missing_weights() -> None:
    assert {name: getattr(make, "name", None) for name, make in TRAINED.items()} == {
        name: name for name in TRAINED
    }
    for make in TRAINED.values():
        with pytest.raises(InputError, match="is missing"):
            make({})
