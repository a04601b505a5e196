import asyncio

import numpy as np
import pytest

from flows.lab.collection.contact_monitor import LEAST, Felt
from operators import Touch
from operators.ports import Run


def rows(counts: float, *, finger: int = 0, valid: bool = True, begin: int = 0) -> Touch:
    """Ten readings around so many counts; one cell differs from the others."""
    noise = np.tile([-1, 1], 5)[:, None]  # (10, 1)
    cells = np.full((10, 6), 500) + noise
    cells[:, 3] = np.rint(counts + noise[:, 0])
    cells = cells.astype(np.int16)
    return Touch(begin + np.arange(10), cells, cells, np.full((10, 6), valid), finger=finger)


def told(run: Run, air: list[Touch], pressed: list[Touch]) -> Felt:
    """What is felt in the air, and then pressed."""

    async def main() -> Felt:
        felt = Felt()
        await felt.open(run)
        for batch in air:
            await felt.write(batch)
        felt.air()
        felt.begin()
        for batch in pressed:
            await felt.write(batch)
        return felt

    return asyncio.run(main())


@pytest.mark.parametrize(("moved", "untouched"), [(0, [0]), (LEAST - 1, [0]), (LEAST, []), (-40, [])])
def test_one_cell_that_moves_is_a_touch(run: Run, moved: float, untouched: list[int]) -> None:
    assert told(run, [rows(400)], [rows(400 + moved)]).untouched() == untouched


def test_each_fingertip_is_judged_by_itself(run: Run) -> None:
    felt = told(run, [rows(400), rows(300, finger=2)], [rows(350), rows(300, finger=2)])
    assert felt.untouched() == [2]


def test_a_fingertip_without_a_reading_is_not_judged(run: Run) -> None:
    assert told(run, [rows(400)], [rows(400, valid=False)]).untouched() == []
    assert told(run, [], [rows(400)]).untouched() == []


def test_the_newest_valid_reading_counts(run: Run) -> None:
    felt = told(run, [rows(400, begin=5)], [rows(400, begin=50, valid=False)])
    assert felt.newest == {0: 14}
