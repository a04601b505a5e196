import numpy as np

from connectors.sim.simulated_rig import true_slips
from operators.batch import Truth, ms


def truth(sliding: list[float], start: int = 0) -> Truth:
    rows = len(sliding)
    time = (start + np.arange(rows)) * 10 * ms
    return Truth(time, np.array(sliding, float), np.full(rows, 2.0), np.zeros((rows, 3)))


def test_a_slip_goes_on_through_short_sticks_and_ends_at_a_long_one() -> None:
    sliding = [0.0] * 5 + [0.05] * 3 + [0.0] * 10 + [0.05] * 2 + [0.0] * 20 + [0.05] + [0.0]
    assert true_slips(truth(sliding)) == [(50 * ms, 190 * ms), (400 * ms, 400 * ms)]


def test_creeping_is_no_slip() -> None:
    assert true_slips(truth([0.002] * 100)) == []
