"""Short forms of the tests of `make chaos`."""

import pytest

from tests.chaos import events, full_disk, recorder
from tests.chaos.run import Promise, Scale, Test, run_test

SHORT = Scale(short=True)


@pytest.mark.parametrize(
    "test",
    [
        recorder.kills,
        full_disk.full_for_a_while,
        pytest.param(events.kills, marks=pytest.mark.broker),
    ],
)
def test_a_promise_is_kept(test: Test) -> None:
    for promise in test(SHORT):
        assert promise.passed, promise.result


def test_an_exception_is_a_failed_test() -> None:
    def fail(_: Scale) -> list[Promise]:
        raise OSError("no disk")

    [promise] = run_test(fail, SHORT)
    assert not promise.passed
    assert "no disk" in promise.result
