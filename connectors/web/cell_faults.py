"""Faults of the cells of fingertips, now and over time."""

from bisect import bisect_right
from collections.abc import Iterator, Mapping
from operator import itemgetter
from typing import Final, TypeAlias

from connectors.events import Fault, faults, finger_name
from operators.batch import Faults
from operators.ports import Json

CellFaults: TypeAlias = Mapping[str, str]  # kind of fault, by cell
NO_FAULTS: Final[CellFaults] = {}


def changes(batch: Faults, before: CellFaults) -> Iterator[tuple[int, CellFaults]]:
    """Yield the time (ns) and the faults after each row of a batch; `before` are the faults before it.

    >>> import numpy as np
    >>> codes, cells = np.array([1, 1], np.int8), np.array([4, 4], np.int8)
    >>> batch = Faults(np.array([5, 9]), cells, codes, np.array([True, False]))
    >>> list(changes(batch, NO_FAULTS))
    [(5, {'4': 'stuck'}), (9, {})]
    """
    found = dict(before)
    for time, fault, begins in faults(batch):
        cell = str(fault.barometer)
        if begins:
            found = {**found, cell: fault.kind}
        elif found.get(cell) == fault.kind:
            found = {each: kind for each, kind in found.items() if each != cell}
        yield time, found


def fault_list(found: CellFaults) -> list[Fault]:
    """Return the faults of a fingertip.

    >>> fault_list({"4": "stuck"})
    [Fault(barometer=4, kind='stuck')]
    """
    return [Fault(int(cell), kind) for cell, kind in found.items()]


class FaultHistory:
    """Faults of each fingertip over time."""

    def __init__(self) -> None:
        self._known: dict[str, list[tuple[int, CellFaults]]] = {}  # changes by fingertip, in order of time

    def add(self, batch: Faults) -> None:
        """Add the changes of a batch."""
        known = self._known.setdefault(finger_name(batch.finger), [])
        known.extend(changes(batch, known[-1][1] if known else NO_FAULTS))

    def at(self, finger: str, time: int) -> CellFaults:
        """Return the faults of a fingertip at a time (ns)."""
        known = self._known.get(finger, [])
        row = bisect_right(known, time, key=itemgetter(0))
        return known[row - 1][1] if row else NO_FAULTS

    def json_at(self, time: int) -> dict[str, Json]:
        """Return the faults of all fingertips that have any at a time (ns)."""
        return {finger: {**found} for finger in self._known if (found := self.at(finger, time))}
