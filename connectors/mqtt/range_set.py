"""Sets of integers, stored as ranges."""

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator


class RangeSet:
    """A set of integers whose memory use depends on the number of gaps, not of elements.

    >>> seen = RangeSet([(1, 3)])
    >>> seen.add(5, 6)
    >>> 4 in seen, list(seen), list(seen.gaps(2, 8))
    (False, [(1, 3), (5, 6)], [(4, 4), (7, 8)])
    >>> seen.add(4)
    >>> list(seen), seen.highest, seen.below(4), seen.below(9), seen.below(0)
    ([(1, 6)], 6, 4, 6, 0)
    """

    def __init__(self, ranges: Iterable[tuple[int, int]] = ()) -> None:
        self._firsts: list[int] = []  # sorted; the ranges neither overlap nor touch
        self._lasts: list[int] = []
        for first, last in ranges:
            self.add(first, last)

    def add(self, first: int, last: int | None = None) -> None:
        """Add one number, or all from `first` to `last`."""
        last = first if last is None else last
        if last < first:
            return
        low = bisect_left(self._lasts, first - 1)  # ranges low..high overlap or touch the new one
        high = bisect_right(self._firsts, last + 1)
        if low < high:
            first, last = min(first, self._firsts[low]), max(last, self._lasts[high - 1])
        self._firsts[low:high], self._lasts[low:high] = [first], [last]

    def __contains__(self, number: int) -> bool:
        at = bisect_left(self._lasts, number)
        return at < len(self._firsts) and self._firsts[at] <= number

    def __iter__(self) -> Iterator[tuple[int, int]]:
        """Iterate over the ranges in order, both ends included."""
        return zip(self._firsts, self._lasts, strict=True)

    def __len__(self) -> int:
        """Return the number of ranges."""
        return len(self._firsts)

    @property
    def highest(self) -> int:
        """The greatest number; 0 if the set is empty."""
        return self._lasts[-1] if self._lasts else 0

    def below(self, limit: int) -> int:
        """Return the greatest number of at most `limit`; 0 if there is none."""
        at = bisect_right(self._firsts, limit)
        return min(self._lasts[at - 1], limit) if at else 0

    def gaps(self, first: int, last: int) -> Iterator[tuple[int, int]]:
        """Yield the ranges between `first` and `last` that are not in the set, in order."""
        at = bisect_left(self._lasts, first)
        while first <= last:
            until = self._firsts[at] - 1 if at < len(self._firsts) else last
            if first <= min(until, last):
                yield first, min(until, last)
            if at == len(self._firsts):
                return
            first, at = self._lasts[at] + 1, at + 1
