import inspect
import pickle

import pytest

import flows.learn.alarm_calibration  # noqa: F401 - its error is tested, too
from operators.errors import SlipflowError


def _kinds(kind: type[SlipflowError]) -> list[type[SlipflowError]]:
    return [kind, *(each for sub in kind.__subclasses__() for each in _kinds(sub))]


@pytest.mark.parametrize("kind", _kinds(SlipflowError))
def test_an_error_can_be_pickled_with_its_attributes(kind: type[SlipflowError]) -> None:
    _, *parameters = inspect.signature(kind.__init__).parameters.values()
    given = [n if each.annotation in (int, float) else each.name for n, each in enumerate(parameters, 1)]
    error = kind(*given)
    error.add_note("while it ran")
    again = pickle.loads(pickle.dumps(error))  # noqa: S301 - our own
    assert type(again) is kind
    assert str(again) == str(error)
    assert vars(again) == vars(error)
