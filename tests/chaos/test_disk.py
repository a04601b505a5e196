from tests.chaos import disk
from tests.chaos.scale import Scale


def test_a_full_disk_stops_the_recording_only_and_what_it_costs_is_counted() -> None:
    promise = disk.full_for_a_while(Scale(short=True))
    assert promise.passed, promise.result
