import pytest

from tests.chaos import latency
from tests.chaos.scale import Scale

pytestmark = pytest.mark.broker


def test_events_arrive_while_a_recording_runs() -> None:
    promise = latency.alert(Scale(short=True))
    assert promise.passed, promise.result
