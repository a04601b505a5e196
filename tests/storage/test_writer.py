from collections.abc import Sequence
from functools import partial
from pathlib import Path

import polars as pl

from operators.batch import Batch, Faults, ms
from operators.errors import EndpointError
from operators.ports import Run
from storage.session import Session
from storage.writer import SessionWriter
from tests.storage.disk_steps import each_kind, observed, steps_of
from tests.storage.made import STREAMS, new_run, rows, side_by_side

SIX: list[tuple[type[Batch], int]] = [*STREAMS, (Faults, 1)]
BATCHES = side_by_side(4, SIX)


def record(root: Path, run: Run, batches: Sequence[Batch]) -> int:
    """Write batches as a runner does, which repeats failed calls; return the number of failures."""
    failures = 0
    try:
        writer = _open(root, run)
    except EndpointError:
        failures += 1
        assert not (root / "sessions/one").exists()
        writer = _open(root, run)
    todo = list(batches)
    while todo:
        try:
            if writer.full(todo[0]):
                writer.commit()
            if not writer.add(todo[0]):
                writer.append(todo[0])
        except EndpointError:
            failures += 1
        else:
            todo.pop(0)
    try:
        writer.close()
    except EndpointError:
        failures += 1
        writer.close()
    return failures


def rows_found(folder: Path, batches: Sequence[Batch]) -> int:
    """Return the number of rows found; assert that they are the beginning of each stream, bit for bit."""
    for path in folder.rglob("*.parquet"):
        assert len(pl.read_parquet(path)) > 0
    return sum(rows(folder, batches, SIX))


def test_a_failure_at_any_step_of_a_replay_costs_nothing_but_a_second_try(tmp_path: Path) -> None:
    steps = steps_of(partial(record, tmp_path / "whole", new_run(live=False), BATCHES))
    assert len(steps) > 60
    for number in each_kind(steps, every=20):
        reached, root = list[str](), tmp_path / str(number)

        def fail(step: str, reached: list[str] = reached, number: int = number) -> None:
            reached.append(step)
            if len(reached) - 1 == number:
                raise OSError(28, "No space left on device")

        with observed(fail):
            record(root, new_run(live=False), BATCHES)
        assert rows_found(root, BATCHES) == sum(map(len, BATCHES)), steps[number]
        assert Session.open(root).about["complete"] is True
        assert list(root.rglob("*.tmp")) == []
        assert not (root / "sessions/one/journal").exists()


def _open(root: Path, run: Run) -> SessionWriter:
    return SessionWriter(root, run, part_span=100 * ms, part_rows=20)
