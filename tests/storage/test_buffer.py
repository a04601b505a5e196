from operators.batch import Touch, ms
from storage.buffer import Buffer
from tests.storage.made import new_batch, same


def test_it_knows_how_many_rows_it_has_and_of_which_time() -> None:
    buffer, late = Buffer(Touch, 4), new_batch(Touch, 2, start=50 * ms)
    assert buffer.plus(late) == (2, 50 * ms, 60 * ms)
    buffer.add(late)
    buffer.add(new_batch(Touch, 3))
    assert (buffer.rows, buffer.first, buffer.last, buffer.end) == (5, 0, 60 * ms, 9)


def test_rows_of_one_fingertip_that_follow_each_other_become_one_batch() -> None:
    buffer, given = Buffer(Touch, 4), [new_batch(Touch, 2, finger=finger) for finger in (0, 0, 1)]
    for batch in given:
        buffer.add(batch)
    found = buffer.numbered()
    assert [(each.first, len(each.batch)) for each in found] == [(4, 4), (8, 2)]
    same(found[1].batch, given[2])
    assert buffer.batches == [each.batch for each in found]
