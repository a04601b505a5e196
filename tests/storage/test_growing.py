from typing import Any

from operators.batch import Clocks, Slips, ms
from storage.growing import Growing
from tests.storage.made import new_batch, same


def test_rows_come_back_as_they_came_in_as_few_batches_as_can_be() -> None:
    rows, given = Growing(Slips, 7), list[Any]()
    for number, finger in enumerate((0, 0, 1, 0, 2, 2)):
        given.append(new_batch(Slips, 3, start=number * 30 * ms, finger=finger, seed=number))
        rows.add(given[-1])
    found = rows.numbered()
    assert [(each.first, each.batch.finger, len(each.batch)) for each in found] == [
        (7, 0, 6),
        (13, 1, 3),
        (16, 0, 3),
        (19, 2, 6),
    ]
    assert (rows.start, rows.rows, rows.end) == (7, 18, 25)
    same(found[0].batch[3:], given[1])
    same(found[2].batch, given[3])
    same(found[3].batch[:3], given[4])


def test_none_are_no_batch() -> None:
    assert Growing(Clocks).numbered() == []


def test_a_row_costs_little_more_than_its_columns() -> None:
    rows = Growing(Slips)
    for number in range(4000):
        rows.add(new_batch(Slips, 1, start=number * 10 * ms))
    held: Any = rows
    assert sum(each.__sizeof__() for each in (*held._columns.values(), held._fingers)) < 40 * 4000
