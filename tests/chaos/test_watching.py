import pytest

from tests.chaos import watching
from tests.chaos.scale import Scale

pytestmark = pytest.mark.broker


def test_a_watch_prints_each_event_once_though_the_rig_is_killed() -> None:
    promise = watching.watch(Scale(short=True))
    assert promise.kept, promise
