import asyncio

import numpy as np

from flows.lab.collection.collector import LEAST_CHANGE, ContactMonitor
from operators import Touch
from operators.ports import Run


def rows(counts: float, finger: int, *, valid: bool = True) -> Touch:
    """Return ten samples; cell 3 has about so many counts, the others 500."""
    cells = np.full((10, 6), 500) + np.tile([-1, 1], 5)[:, None]
    cells[:, 3] += round(counts) - 500
    cells = cells.astype(np.int16)
    return Touch(np.arange(10), cells, cells, np.full((10, 6), valid), finger=finger)


def test_each_fingertip_is_judged_by_its_cell_that_changes_most(run: Run) -> None:
    """Finger 3 gives no valid sample, finger 4 gave none in the air."""
    changes = {0: 0, 1: LEAST_CHANGE - 1, 2: LEAST_CHANGE, 3: 0, 5: -40}

    async def main() -> ContactMonitor:
        monitor = ContactMonitor()
        await monitor.open(run)
        for finger in changes:
            await monitor.write(rows(400, finger))
        monitor.set_baseline()
        monitor.restart()
        for finger, change in {**changes, 4: 0}.items():
            await monitor.write(rows(400 + change, finger, valid=finger != 3))
        return monitor

    monitor = asyncio.run(main())
    assert monitor.without_contact() == [0, 1]
    assert monitor.newest == dict.fromkeys(changes | {4: 0}, 9)
