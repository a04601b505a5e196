import operators
from operators import detectors
from operators.detectors import DETECTORS


def test_every_public_name_is_there_and_named_once() -> None:
    for module in (operators, detectors):
        assert all(hasattr(module, name) for name in module.__all__)
        assert len(set(module.__all__)) == len(module.__all__)


def test_detectors_that_need_no_weights_are_known_by_their_names() -> None:
    assert {name: make().name for name, make in DETECTORS.items()} == {name: name for name in DETECTORS}
