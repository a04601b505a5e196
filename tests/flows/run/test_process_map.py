import os

import pytest

from flows.run.process_map import process_map
from operators.errors import SlipflowError


def test_results_come_in_the_order_of_the_items() -> None:
    assert list(process_map(abs, [-3, 2, -1], 2)) == list(process_map(abs, [-3, 2, -1], 1)) == [3, 2, 1]


def test_what_the_work_raises_is_raised() -> None:
    with pytest.raises(ValueError, match="invalid literal"):
        list(process_map(int, ["1", "one"], 2))


def test_a_process_that_is_killed_is_told_in_one_line() -> None:
    with pytest.raises(SlipflowError, match="one of 2 processes ended early"):
        list(process_map(os._exit, [1, 1], 2))
