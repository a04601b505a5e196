from collections.abc import Sequence

from tests.chaos.promise import Promise, table
from tests.chaos.run import run_test, subjects
from tests.chaos.scale import Scale


def test_every_subject_has_promises_that_say_what_they_are() -> None:
    found = subjects()
    assert {"recorder", "power_cut", "bit_flips", "disk", "flood", "soak"} <= found.keys()
    for subject, tests in found.items():
        assert tests, subject
        assert all(test.__doc__ for test in tests), subject


def test_a_test_that_fails_has_kept_nothing_and_the_others_go_on() -> None:
    def fails(_: Scale) -> Sequence[Promise]:
        raise OSError("no disk")

    [promise] = run_test(fails, Scale())
    assert not promise.passed
    assert "no disk" in promise.result
    assert table([promise]).splitlines()[1].endswith("NO")
