from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from connectors.mqtt.range_set import RangeSet

ranges = st.lists(st.tuples(st.integers(1, 40), st.integers(0, 6)).map(lambda r: (r[0], r[0] + r[1])))


@given(ranges, st.integers(1, 50), st.integers(1, 50))
def test_it_contains_exactly_the_added_numbers(added: list[tuple[int, int]], first: int, last: int) -> None:
    numbers, expected = RangeSet(added), {n for low, high in added for n in range(low, high + 1)}
    assert {n for n in range(60) if n in numbers} == expected
    assert numbers.highest == max(expected, default=0)
    found = [n for low, high in numbers.gaps(first, last) for n in range(low, high + 1)]
    assert found == [n for n in range(first, last + 1) if n not in expected]


@given(ranges)
def test_its_ranges_are_in_order_and_do_not_touch(added: list[tuple[int, int]]) -> None:
    numbers = RangeSet(added)
    found = list(numbers)
    assert len(numbers) == len(found)
    assert all(high + 1 < low for (_, high), (low, _) in pairwise(found))
    assert list(RangeSet(found)) == found


def test_a_range_that_ends_before_it_begins_is_empty() -> None:
    numbers = RangeSet()
    numbers.add(1, 0)
    assert not len(numbers)
