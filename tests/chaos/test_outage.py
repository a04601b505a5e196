import pytest

from tests.chaos import outage
from tests.chaos.scale import Scale

pytestmark = pytest.mark.broker


def test_what_happens_while_the_broker_is_away_comes_afterwards_in_order() -> None:
    promise = outage.outage(Scale(short=True))
    assert promise.kept, promise
