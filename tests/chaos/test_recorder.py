from tests.chaos import recorder
from tests.chaos.scale import Scale


def test_a_killed_recorder_loses_few_rows_and_leaves_none_that_is_wrong() -> None:
    for promise in recorder.kills(Scale(short=True)):
        assert promise.passed, promise.result
