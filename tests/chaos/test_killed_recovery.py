from tests.chaos import killed_recovery
from tests.chaos.scale import Scale


def test_a_killed_recovery_is_finished_by_the_next() -> None:
    promise = killed_recovery.kills(Scale(short=True))
    assert promise.passed, promise.result
