import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock

import polars as pl
import pytest

from operators.batch import EVERY, Batch, Episodes, Faults, Touch, concat, ms
from operators.errors import EndpointError
from operators.ports import Run
from storage.journal_segment import SINGLE_LOG, read_segment
from storage.layout import single_log
from storage.session import Session
from storage.writer import SessionWriter
from tests.storage.made import STREAMS, new_episodes, new_run, rows, same, side_by_side

SIX: list[tuple[type[Batch], int]] = [*STREAMS, (Faults, 1)]
BATCHES = side_by_side(4, SIX)


class Killed(BaseException):
    """What the process does at this step is its last."""


@dataclass
class Disk:
    """Numbers the steps of a recording, each fsync and each rename, and calls `before` ahead of each."""

    before: Callable[[int], None]
    step: int = field(default=0, init=False)

    def watch(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for name in ("fsync", "replace"):
            monkeypatch.setattr(os, name, self._watched(getattr(os, name)))

    def _watched(self, real: Callable[..., None]) -> Callable[..., None]:
        def call(*args: object) -> None:
            self.step += 1
            self.before(self.step)
            real(*args)

        return call


def record(root: Path, run: Run, batches: Sequence[Batch]) -> int:
    """As a runner does, which tries again what failed; give the failures."""
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
    """How much a reader finds, once it is sure that it is the beginning of each stream, bit for bit."""
    for path in folder.rglob("*.parquet"):
        assert len(pl.read_parquet(path)) > 0
    return sum(rows(folder, batches, SIX))


def test_a_failure_at_any_step_costs_nothing_but_a_second_try(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(step: int) -> None:
        if step == last:
            raise OSError(28, "No space left on device")

    last, failures = 0, 1
    while failures:
        last += 1
        root = tmp_path / str(last)
        with monkeypatch.context() as patch:
            Disk(fail).watch(patch)
            failures = record(root, new_run(live=False), BATCHES)
        assert rows_found(root, BATCHES) == sum(map(len, BATCHES))
        assert Session.open(root).about["complete"] is True
        assert list(root.rglob("*.tmp")) == []
    assert last > 30


def test_with_a_journal_too_a_failure_at_any_step_costs_nothing_but_a_second_try(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counting, reached, last = Lock(), list[str](), 0

    def fail(step: str) -> None:
        with counting:
            reached.append(step)
            failing = len(reached) == last
        if failing:
            raise OSError(28, "No space left on device")

    while len(reached) >= last:
        last += 1
        reached.clear()
        root = tmp_path / str(last)
        with monkeypatch.context() as patch:
            patch.setattr("storage.steps.reach", fail)
            record(root, new_run(), BATCHES)
        assert rows_found(root, BATCHES) == sum(map(len, BATCHES)), last
        assert Session.open(root).about["complete"] is True
        assert list(root.rglob("*.tmp")) == []
        assert not (root / "sessions/one/journal").exists()
    assert last > 60


def test_a_kill_at_any_step_leaves_whole_parts_and_a_dataset_that_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def kill(step: int) -> None:
        if step == last:
            raise Killed

    found, last, done = [0], 0, False
    while not done:
        last += 1
        root = tmp_path / str(last)
        with monkeypatch.context() as patch, suppress(Killed):
            Disk(kill).watch(patch)
            record(root, new_run(live=False), BATCHES)
            done = True
        if (root / "sessions/one/session.json").exists():
            found.append(rows_found(root / "sessions/one", BATCHES))
        record(root, new_run("two", live=False), BATCHES[:6])
        assert rows_found(root / "sessions/two", BATCHES[:6]) == 30
    assert found == sorted(found)
    assert found[-1] == sum(map(len, BATCHES))


def test_a_reader_sees_only_whole_parts_at_any_step_of_the_writer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[int] = []

    def look(_: int) -> None:
        if (tmp_path / "sessions/one/session.json").exists():
            found.append(rows_found(tmp_path, BATCHES))

    Disk(look).watch(monkeypatch)
    record(tmp_path, new_run(live=False), BATCHES)
    assert found == sorted(found)
    assert len(set(found)) > 6


def test_a_disk_that_stays_full_keeps_no_more_in_memory_and_loses_nothing_that_was_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: int) -> None:
        raise OSError(28, "No space left on device")

    writer, taken = _open(tmp_path, new_run(live=False)), list[Batch]()
    with monkeypatch.context() as patch:
        Disk(fail).watch(patch)
        for batch in BATCHES:
            with suppress(EndpointError):
                if writer.full(batch):
                    writer.commit()
                writer.add(batch)
                taken.append(batch)
    assert sum(len(batch) for batch in taken if type(batch) is Touch) == 20
    writer.close()
    assert rows_found(tmp_path, taken) == sum(map(len, taken))


def test_episodes_of_a_live_run_are_in_the_journal_until_the_session_ends(tmp_path: Path) -> None:
    writer = _open(tmp_path, new_run())
    written = [new_episodes((n * 100 * ms, (n + 1) * 100 * ms, "tap")) for n in range(4)]
    for episode in written:
        writer.add(episode)
        writer.commit()
    assert Session.open(writer.folder).tables == ()
    found = read_segment(single_log(writer.folder).read_bytes(), "", "one", SINGLE_LOG)
    assert [(rows.first, rows.batch.time.item()) for rows in found.rows] == [
        (n, n * 100 * ms) for n in range(4)
    ]
    writer.close()
    [episodes] = Session.open(tmp_path).read(Episodes, EVERY)
    same(episodes, concat(Episodes, written))


def _open(root: Path, run: Run) -> SessionWriter:
    return SessionWriter(root, run, part_span=100 * ms, part_rows=20)
