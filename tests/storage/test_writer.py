from collections.abc import Sequence
from contextlib import suppress
from errno import EIO
from functools import partial
from pathlib import Path

import polars as pl
import pytest

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
        with suppress(EndpointError):
            if writer.unsynced:
                writer.sync()
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


def test_a_failure_at_any_step_of_a_replay_but_the_last_fsyncs_costs_nothing_but_a_second_try(
    tmp_path: Path,
) -> None:
    steps = steps_of(partial(record, tmp_path / "whole", new_run(live=False), BATCHES))
    assert len(steps) > 60
    last = min(map(steps.index, ("fsync part", "fsync manifest", "fsync session")))
    for number in each_kind(steps[:last], every=20):
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


def test_the_files_of_a_replay_are_made_durable_before_their_names_and_before_its_end(tmp_path: Path) -> None:
    steps = steps_of(partial(record, tmp_path / "data", new_run(live=False), BATCHES))
    end = max(number for number, step in enumerate(steps) if step == "create_file new session")
    synced = [(number, step.split()[1]) for number, step in enumerate(steps) if step.startswith("fsync ")]
    synced = [(number, name) for number, name in synced if "dataset" not in (name, steps[number].split()[-1])]
    content = [number for number, name in synced if name in {"part", "manifest", "session"} and number < end]
    assert len(content) == len(list((tmp_path / "data/sessions/one").rglob("*.*")))
    assert {"touch", "motion", "one", "sessions"} <= {name for n, name in synced if max(content) < n < end}


def test_a_replay_whose_fsync_failed_is_never_complete(tmp_path: Path) -> None:
    def fail(step: str) -> None:
        if step == "fsync part":
            raise OSError(5, "Input/output error")

    writer = _open(tmp_path, new_run(live=False))
    writer.add(BATCHES[0])
    with observed(fail), pytest.raises(EndpointError, match="Input/output error"):
        writer.close()
    for _ in range(2):
        with pytest.raises(EndpointError, match="the disk has lost what was written; run the replay again"):
            writer.close()
    assert Session.open(tmp_path).about["complete"] is False


def _open(root: Path, run: Run) -> SessionWriter:
    return SessionWriter(root, run, part_span=100 * ms, part_rows=20)


def test_pending_rows_are_those_that_a_killed_process_would_lose(tmp_path: Path) -> None:
    writer = _open(tmp_path, new_run())
    writer.add(BATCHES[0])
    assert writer.pending == 5
    writer.append()
    assert writer.pending == 0

    def fail(step: str) -> None:
        if step == "fsync segment":
            raise OSError(EIO, "Input/output error")

    with observed(fail), pytest.raises(EndpointError):
        writer.sync()
    assert writer.pending == 5  # the journal may have lost them
    writer.begin_commit()
    assert writer.pending == 5
    writer.commit()
    assert writer.pending == 0
    writer.close()
