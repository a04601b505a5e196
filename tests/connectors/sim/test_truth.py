import numpy as np

from connectors.sim.truth import Memory, Truth
from operators.batch import ms


def truth(sliding: list[float], start: int = 0) -> Truth:
    rows = len(sliding)
    time = (start + np.arange(rows)) * 10 * ms
    return Truth(time, np.array(sliding, float), np.full(rows, 2.0), np.zeros((rows, 3)))


def test_a_slip_goes_on_through_short_sticks_and_ends_at_a_long_one() -> None:
    sliding = [0.0] * 5 + [0.05] * 3 + [0.0] * 10 + [0.05] * 2 + [0.0] * 20 + [0.05] + [0.0]
    assert truth(sliding).slips == [(50 * ms, 190 * ms), (400 * ms, 400 * ms)]


def test_creeping_is_no_slip() -> None:
    assert truth([0.002] * 100).slips == []


def test_memory_keeps_the_newest_rows_in_bounded_space() -> None:
    memory = Memory(10)
    for start in range(0, 100, 7):
        memory.add(truth([float(start + row) for row in range(7)], start))
    recalled = memory.recall(5)
    assert 10 <= len(recalled) <= 20
    np.testing.assert_array_equal(recalled.time, recalled.sliding * 10 * ms + 5)
    assert recalled.sliding[-1] == 104


def test_more_rows_than_memory_holds_leave_the_newest() -> None:
    memory = Memory(10)
    memory.add(truth([float(row) for row in range(50)]))
    assert memory.recall(0).sliding.tolist() == [float(row) for row in range(40, 50)]
