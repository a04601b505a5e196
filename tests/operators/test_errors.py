import errno
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
from operators.errors import os_error_reason


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


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (
            PermissionError(errno.EACCES, "Permission denied", "/data"),
            "Permission denied; grant this user permission",
        ),
        (
            FileExistsError(errno.EEXIST, "File exists", "/data/sessions"),
            "File exists, /data/sessions; a file exists where a folder is needed",
        ),
        (FileNotFoundError(errno.ENOENT, "No such file or directory"), "No such file or directory"),
        (OSError("only words"), "only words"),
        (OSError(), "OSError"),
    ],
)
def test_an_error_of_the_operating_system_has_a_remedy(error: OSError, text: str) -> None:
    assert os_error_reason(error) == text
