import asyncio

import numpy as np
import pytest

from flows.lab.collection.collector import LEAST_CHANGE, ContactMonitor
from operators import Touch
from operators.ports import Run


def rows(counts: float, *, finger: int = 0, valid: bool = True, begin: int = 0) -> Touch:
    """Return ten samples; cell 3 has about so many counts, the others 500."""
    noise = np.tile([-1, 1], 5)[:, None]  # (10, 1)
    cells = np.full((10, 6), 500) + noise
    cells[:, 3] = np.rint(counts + noise[:, 0])
    cells = cells.astype(np.int16)
    return Touch(begin + np.arange(10), cells, cells, np.full((10, 6), valid), finger=finger)


def monitored(run: Run, air: list[Touch], pressed: list[Touch]) -> ContactMonitor:
    """Return a monitor after samples in the air and samples under pressure."""

    async def main() -> ContactMonitor:
        monitor = ContactMonitor()
        await monitor.open(run)
        for batch in air:
            await monitor.write(batch)
        monitor.set_baseline()
        monitor.restart()
        for batch in pressed:
            await monitor.write(batch)
        return monitor

    return asyncio.run(main())


@pytest.mark.parametrize(
    ("change", "without"), [(0, [0]), (LEAST_CHANGE - 1, [0]), (LEAST_CHANGE, []), (-40, [])]
)
def test_one_cell_that_changes_is_contact(run: Run, change: float, without: list[int]) -> None:
    assert monitored(run, [rows(400)], [rows(400 + change)]).without_contact() == without


def test_each_fingertip_is_judged_separately(run: Run) -> None:
    monitor = monitored(run, [rows(400), rows(300, finger=2)], [rows(350), rows(300, finger=2)])
    assert monitor.without_contact() == [2]


def test_a_fingertip_without_samples_is_not_judged(run: Run) -> None:
    assert monitored(run, [rows(400)], [rows(400, valid=False)]).without_contact() == []
    assert monitored(run, [], [rows(400)]).without_contact() == []


def test_the_newest_valid_sample_counts(run: Run) -> None:
    monitor = monitored(run, [rows(400, begin=5)], [rows(400, begin=50, valid=False)])
    assert monitor.newest == {0: 14}
