from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from flows.lab.experiments.decisions import registered, slipping
from flows.lab.experiments.trial import Trace
from operators.batch import Reals

Make: TypeAlias = Callable[..., Trace]
During: TypeAlias = Callable[..., Reals]


def test_a_slip_is_registered_while_enough_decisions_in_a_row_say_so() -> None:
    probability = np.array([0.9, 0.9, 0.9, 0.1, 0.9, np.nan, 0.9, 0.9])
    assert slipping(probability, 0.5, 2).tolist() == [False, True, True, False, False, False, False, True]
    assert slipping(probability, 0.5, 1).tolist() == [True, True, True, False, True, False, True, True]


def test_each_slip_is_registered_once_at_its_first_time(made: Make, during: During) -> None:
    trace = made(probability=during((2.0, 2.5), (3.0, 3.01), (4.0, 4.02)))
    assert registered(trace, 0.5, 2).tolist() == [2.01, 4.01]
