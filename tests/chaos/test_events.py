import pytest

from tests.chaos import events
from tests.chaos.scale import Scale

pytestmark = pytest.mark.broker


def test_whatever_is_killed_no_event_is_lost() -> None:
    promise = events.kills(Scale(short=True))
    assert promise.kept, promise
