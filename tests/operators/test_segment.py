"""What a segment owes beyond the conformance of its operators: queues, cells, blocks, fingertips, order."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
import pytest

from operators import (
    Align,
    Batch,
    BatchError,
    Debounce,
    Join,
    Motion,
    Operator,
    Sample,
    Scores,
    Slips,
    Touch,
    Zero,
    Zeroed,
    concat,
    ms,
    s,
)
from operators.batch import Reals, Times
from operators.operator import AnyOperator
from operators.program import BLOCK
from operators.steps import Record, RowType, Steps, copy
from tests.operators import test_conformance as suite
from tests.storage.made import same

CUTS: Final = [[], range(5000), [0, 1, 700, 1024, 1025, 1400]]
PREVIOUS: Final = Align(how="previous", within=5 * ms, keep=100 * ms)


def _times(rows: int, rate: float, start: int = 0) -> Times:
    return start + (np.arange(rows) * (s / rate)).astype(np.int64)


def _touch(time: Times, cells: int = 6) -> Zeroed:
    counts = (np.arange(len(time) * cells).reshape(-1, cells) % 700).astype(np.int16)
    return Zeroed(time, counts, counts, counts >= 0, finger=3)


def _raw(rows: int, cells: int) -> Touch:
    """Raw touch with all that the conformance streams contain, in any number of cells."""
    [touch] = suite.CASES[0].streams(7, rows)
    assert isinstance(touch, Touch)
    counts, temperature = (np.tile(each, (1, 2))[:, :cells] for each in (touch.counts, touch.temperature))
    return Touch(touch.time, counts, temperature, np.tile(touch.valid, (1, 2))[:, :cells], finger=3)


def _motion(time: Times, speed: float | Reals = 0.1) -> Motion:
    velocity = np.zeros((len(time), 6))
    velocity[:, 0] = speed
    return Motion(time, time, velocity, np.full_like(velocity, np.nan))


def _sample(time: Times, speed: Reals) -> Sample:
    return Align(how="previous", wait=0, keep=100 * ms).push(_touch(time), _motion(time, speed))


def _runs(step: AnyOperator, *streams: Batch) -> list[Batch]:
    """The output, however the input is cut."""
    return [suite.run(step.reset_copy(), suite.pieces(streams, cuts)) for cuts in CUTS]


def _check_equal(batches: Iterable[Batch]) -> Batch:
    first, *others = batches
    for each in others:
        same(each, first)
    return first


def test_touch_that_finds_the_queue_full_is_released_early_and_unmatched() -> None:
    """The queue is for 1 kHz; this is 10 kHz while motion lags by 120 ms."""
    touch, motion = _touch(_times(1500, 10_000)), _motion(_times(2, 100, 120 * ms))
    samples = _check_equal(_runs(Align(within=50 * ms, wait=900 * ms), touch, motion))
    assert isinstance(samples, Sample)
    assert samples.time.tolist() == touch.time.tolist()
    early = 1200 - 1023  # when the motion arrived
    assert samples.matched.tolist() == [False] * 700 + [True] * 800
    assert len(Align(within=50 * ms, wait=900 * ms).push(touch[:1200], motion[:0])) == early


def test_a_fingertip_with_another_number_of_cells_than_described_is_named() -> None:
    zero = Zero(scans=30)
    zero.push(_raw(3, 6))
    for rows in (1, 3):
        with pytest.raises(
            BatchError, match=r"^Touch\.counts: has 9 cells, but the fingertip was .* with 6$"
        ):
            zero.push(_raw(rows, 9))


@dataclass
class _First(Join[Touch, Touch, Touch]):
    def steps(self, *given: RowType) -> Steps:
        return Steps(
            state={"row": np.zeros((), given[0].packed), "new": 0}, takes=(_keep, _keep), give=_first
        )


def _keep(settings: Record, state: Record, row: Record) -> None:
    copy(state.row, row)
    state.new = 1


def _first(settings: Record, state: Record, out: Record) -> bool:
    if not state.new:
        return False
    copy(out, state.row)
    state.new = 0
    return True


def test_the_output_of_a_join_has_the_cells_of_the_first_input_with_cells() -> None:
    assert _First().row_type(RowType(Motion), RowType(Touch, 4)).cells == 4


def test_an_input_without_rows_yet_has_the_cells_of_the_other() -> None:
    join, rows = _First(), _raw(3, 4)
    assert join.push(Touch.empty(), rows[:1]).cells == 4
    assert join.push(rows[1:2], Touch.empty()).time.tolist() == rows.time[1:2].tolist()


@pytest.mark.parametrize("rate", [1000.0, np.inf], ids=["in time", "of one time"])
def test_more_rows_than_a_call_takes_are_those_of_many_calls(rate: float) -> None:
    rows = 3 * BLOCK + 7
    scores = Scores(_times(rows, rate), np.random.default_rng(0).random(rows), finger=3)
    late = Scores.rows([-1], 0.5, finger=3)
    whole, cut = Debounce(), Debounce()
    found = whole.push(concat(Scores, [scores, late]))
    same(found, concat(Slips, [cut.push(scores[row : row + 1000]) for row in range(0, rows, 1000)]))
    assert len(found) > BLOCK // 4
    assert (whole.late, cut.push(late).time.size, cut.late) == (1, 0, 1)


@pytest.mark.parametrize("rate", [4000.0, np.inf], ids=["in time", "of one time"])
def test_two_inputs_with_more_rows_than_a_call_takes_come_in_the_order_of_time(rate: float) -> None:
    """Motion at the time of the touch comes before it, later motion after it."""
    touch = _touch(_times(2 * BLOCK, rate))
    motion = _motion(_times(4000, 400), np.arange(4000) / 1e5)
    samples = _check_equal(_runs(PREVIOUS, touch, motion))
    assert isinstance(samples, Sample)
    assert samples.matched.all()
    np.testing.assert_array_equal(samples.velocity[:, 0], touch.time // (s // 400) / 1e5)


def _take(settings: Record, state: Record, row: Record) -> None:
    state.left = settings.copies


def _give(settings: Record, state: Record, out: Record) -> bool:
    if state.left == 0:
        return False
    state.left -= 1
    out.time, out.probability = state.left, 0.5
    return True


class _Copies(Operator[Scores, Scores]):
    """Gives three rows for one, but allows for one."""

    def steps(self, *given: RowType) -> Steps:
        return Steps({"copies": 3}, {"left": 0}, takes=(_take,), give=_give)


def test_more_rows_than_an_operator_allows_for_are_an_error() -> None:
    with pytest.raises(BatchError, match=r"more rows than `held` and `factor` of its Steps allow"):
        _Copies().push(Scores.zeros(BLOCK))
