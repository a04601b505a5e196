"""Short forms of the tests of `make chaos`."""

import pytest

from tests.chaos import events, recorder
from tests.chaos.run import Scale, Test

SHORT = Scale(short=True)


@pytest.mark.parametrize("test", [recorder.kills, pytest.param(events.kills, marks=pytest.mark.broker)])
def test_a_promise_is_kept(test: Test) -> None:
    for promise in test(SHORT):
        assert promise.passed, promise.result
