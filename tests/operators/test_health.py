from dataclasses import replace

import numpy as np
import pytest

from operators import TAKKTILE, FaultKind, Faults, Health, Touch, Zeroed, concat, ms, s
from operators.batch import Counts, Flags

Change = tuple[float, int, FaultKind, bool]  # s, barometer, kind, begins


def _touch(seconds: float, level: float = 600, seed: int = 0) -> tuple[Counts, Flags]:
    """An unloaded fingertip at 100 Hz: noise of 0.6 counts."""
    rng = np.random.default_rng(seed)
    counts = np.rint(rng.normal(level, 0.6, (round(100 * seconds), 6))).astype(np.int16)
    return counts, np.ones_like(counts, np.bool_)


def _changes(
    counts: Counts,
    valid: Flags,
    health: Health | None = None,
    kind: type[Touch] = Touch,
    pause: int = 0,
    period: int = 10 * ms,
) -> list[Change]:
    """Return the faults of rows a period apart, with a pause after 100 rows."""
    time = np.arange(len(counts)) * period
    time[100:] += pause
    health = Health() if health is None else health
    batch = kind(time, counts, counts, valid, finger=8)
    faults = concat(Faults, [health.push(batch), health.flush()])
    assert faults.finger == 8 or not len(faults)
    rows = zip(faults.time, faults.barometer, faults.kind, faults.active, strict=True)
    return [(int(at) / s, int(cell), FaultKind(name), bool(active)) for at, cell, name, active in rows]


def test_a_cell_is_dead_once_it_has_not_answered_for_half_a_second_until_it_does() -> None:
    counts, valid = _touch(4)
    valid[101:250, 3] = False
    assert _changes(counts, valid) == [(1.5, 3, FaultKind.DEAD, True), (2.5, 3, FaultKind.DEAD, False)]


def test_a_cell_is_stuck_once_its_count_has_not_changed_for_two_seconds_until_it_does() -> None:
    counts, valid = _touch(5)
    counts[100:400, 5] = 610
    valid[120:140, 5] = False  # what did not come has not changed
    assert _changes(counts, valid) == [(3.0, 5, FaultKind.STUCK, True), (4.0, 5, FaultKind.STUCK, False)]


def test_a_cell_at_the_end_of_its_range_is_stuck_only_if_it_begins_there() -> None:
    counts, valid = _touch(6)
    counts[100:400, 0], counts[:, 1] = 0, 0
    found = [(cell, kind) for _, cell, kind, begins in _changes(counts, valid) if begins]
    assert found == [(1, FaultKind.SATURATED), (0, FaultKind.SATURATED), (1, FaultKind.STUCK)]


@pytest.mark.parametrize("answers", [True, False])
def test_a_cell_that_was_in_its_range_once_is_not_stuck_at_the_end_of_it(*, answers: bool) -> None:
    counts, valid = _touch(6)
    counts[1:, 0], valid[0, 0] = 1023, answers
    found = [kind for *_, kind, begins in _changes(counts, valid) if begins]
    assert found == [FaultKind.SATURATED] if answers else [FaultKind.SATURATED, FaultKind.STUCK]


def test_a_dead_cell_is_not_stuck_until_it_answers_without_change() -> None:
    counts, valid = _touch(6)
    counts[100:, 1] = 610
    valid[101:301, 1] = False
    dead = [(1.5, 1, FaultKind.DEAD, True), (3.01, 1, FaultKind.DEAD, False)]
    assert _changes(counts, valid) == [*dead, (5.0, 1, FaultKind.STUCK, True)]


@pytest.mark.parametrize("rail", [0, 10, 1013, 1023])
def test_a_cell_at_either_end_of_its_range_for_50_ms_is_saturated(rail: int) -> None:
    counts, valid = _touch(2)
    counts[100:110, 4] = rail
    counts[150:154, 4] = rail  # sound again within 50 ms
    saturated = [(1.04, 4, FaultKind.SATURATED, True), (1.1, 4, FaultKind.SATURATED, False)]
    assert _changes(counts, valid) == saturated
    assert _changes(counts, valid, kind=Zeroed) == []


def test_a_fault_that_comes_again_before_it_is_cleared_has_not_ended() -> None:
    counts, valid = _touch(4)
    for again in (100, 130, 160):
        counts[again : again + 10, 4] = 0
    saturated = [(1.04, 4, FaultKind.SATURATED, True), (2.19, 4, FaultKind.SATURATED, False)]
    assert _changes(counts, valid, Health(clear_after=500 * ms)) == saturated


def test_a_pause_of_the_stream_is_no_evidence() -> None:
    counts, valid = _touch(2)
    counts[99:101, 0] = 650
    counts[99:104, 1] = 1023
    valid[99:140, 2] = False
    assert _changes(counts, valid, pause=60 * s) == [
        (61.02, 1, FaultKind.SATURATED, True),
        (61.04, 1, FaultKind.SATURATED, False),
    ]


def test_a_load_that_stays_constant_after_an_unloaded_second_is_no_fault() -> None:
    counts, valid = _touch(8)
    counts[200:] -= 40
    assert _changes(counts, valid) == []
    assert _changes(counts, valid, kind=Zeroed) == []


@pytest.mark.parametrize("rate", [1000, 100, 20, 10, 4])
def test_a_cell_of_a_fingertip_of_any_rate_is_dead_half_a_second_after_its_last_answer(rate: int) -> None:
    period = s // rate
    counts, valid = _touch(4 * rate / 100)
    valid[rate + 1 :, 3] = False  # the last answer comes after one second
    health = Health(stuck_after=60 * s).for_fingertip(replace(TAKKTILE, rate=float(rate)))
    assert _changes(counts, valid, health, period=period) == [(1.5, 3, FaultKind.DEAD, True)]
