import pickle

import pytest

from operators import (
    BatchError,
    EndpointError,
    FlowError,
    InputError,
    OperatorError,
    ParameterError,
    SlipflowError,
)


@pytest.mark.parametrize(
    "error",
    [
        SlipflowError("plain"),
        ParameterError("Align", "wait", 3, "at least 5"),
        BatchError("Touch", "counts", "has shape (2,)"),
        FlowError("f", "a -> b", "wrong"),
        OperatorError("f", "Press", "failed"),
        InputError("trace.csv", "is empty"),
        EndpointError("mqtt://host", "down"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_an_error_can_be_pickled_with_its_attributes(error: SlipflowError) -> None:
    error.add_note("while it ran")
    again = pickle.loads(pickle.dumps(error))  # noqa: S301 - our own
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again) == vars(error)
