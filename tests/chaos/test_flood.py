from tests.chaos import flood
from tests.chaos.scale import Scale


def test_a_flood_costs_the_recorder_no_row_and_is_over_soon() -> None:
    promise = flood.flood(Scale(short=True))
    assert promise.passed, promise.result
