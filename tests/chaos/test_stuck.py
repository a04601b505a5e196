from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.chaos import stuck
from tests.chaos.promise import Promise
from tests.chaos.scale import Scale

pytestmark = pytest.mark.broker


def put_to_the_test(hold: Callable[[Scale], Promise]) -> Promise:
    return hold(Scale(short=True))


def test_whoever_is_stuck_holds_up_no_other_and_gets_all_afterwards() -> None:
    with ThreadPoolExecutor() as threads:  # each mostly waits
        for promise in threads.map(put_to_the_test, (stuck.silent_line, stuck.stopped_consumer)):
            assert promise.kept, promise
