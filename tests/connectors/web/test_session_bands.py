import asyncio
from typing import Any

import numpy as np

from connectors.web.session_bands import Runs, SessionBands
from operators.batch import Truth, ms, s
from operators.ports import Run


def test_runs_end_where_the_value_changes_or_a_pause_begins() -> None:
    time = np.array([0, 10, 20, 30, 1000]) * ms
    runs = Runs.of(time, np.array([0, 0, 1, 1, 1], np.int8))
    assert runs.between(0, 2000 * ms, 100, 0) == [[0, 20, 0], [20, 30, 1], [1000, 1000, 1]]
    assert runs.between(25 * ms, 500 * ms, 100, 20 * ms) == [[0, 10, 1]]


def test_late_rows_and_no_rows_are_no_runs() -> None:
    runs = Runs.of(np.array([0, 20, 10, 30]) * ms, np.array([0, 0, 1, 0], np.int8))
    assert runs.between(0, s, 100, 0) == [[0, 30, 0]]
    assert Runs.of(np.empty(0, np.int64), np.empty(0, np.int8)).between(0, s, 100, 0) == []


def test_runs_narrower_than_a_pixel_are_left_out_if_there_are_many() -> None:
    time, code = np.arange(1000) * ms, np.arange(1000).astype(np.int8) % 2
    code[500:] = 1
    assert Runs.of(time, code).between(0, s, 10, 0) == [[499, 999, 1]]


def test_a_stick_phase_is_part_of_a_true_slip(run: Run) -> None:
    rows = 100
    sliding = np.zeros(rows)
    sliding[20:40] = 0.02
    sliding[45:60] = 0.02  # 50 ms later
    time = run.start + np.arange(rows) * 10 * ms

    async def main() -> SessionBands:
        bands = SessionBands()
        await bands.open(run)
        await bands.write(Truth(time, sliding, sliding, np.zeros((rows, 3)), finger=3))
        await bands.close()
        return bands

    found: dict[str, Any] = {**asyncio.run(main()).window(0, 1000, 1000)}
    assert found == {"truth": {"3": [[0, 200, 0], [200, 600, 1], [600, 990, 0]]}}
