import pytest

from tests.chaos import refusals
from tests.chaos.scale import Scale

pytestmark = pytest.mark.broker


def test_a_broker_that_refuses_is_an_error_that_says_what_to_do_and_costs_no_event() -> None:
    for promise in refusals.refusals(Scale(short=True)):
        assert promise.passed, promise
