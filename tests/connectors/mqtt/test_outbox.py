import asyncio
import shutil
import sqlite3
import threading
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from connectors.events import Event
from connectors.mqtt import outbox
from connectors.mqtt.outbox import Outbox
from connectors.mqtt.outbox_file import OutboxFile
from operators.errors import EndpointError, InputError
from tests.connectors.mqtt.broker_process import PATIENCE, until
from tests.inside import inside

DRAFT = Event("lab", "rig", "0", "", 0, onset=True, time=1, probability=0.9, latency=1.0)


@asynccontextmanager
async def opened(path: Path, keep: int = 1000) -> AsyncGenerator[Outbox]:
    box = Outbox(path, keep=keep, keep_for=1e9)
    await box.open()
    try:
        yield box
    finally:
        await box.close()


async def send(box: Outbox, limit: int = 1000) -> list[str]:
    """Take what waits, all of it acknowledged."""
    found = list[str]()
    while entries := await box.next(min(limit, 100)):
        found += [Event.decode(entry.payload).identifier for entry in entries]
        box.acknowledge(entries)
        limit -= len(entries)
        if limit <= 0:
            break
    return found


class Failing:
    """Makes the file fail as long as it is told to."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
        self.error: BaseException | None = error
        append = OutboxFile.append

        def fail(file: OutboxFile, *args: Any) -> None:  # noqa: ANN401
            if self.error:
                raise self.error
            append(file, *args)

        monkeypatch.setattr(OutboxFile, "append", fail)


async def test_numbers_continue_from_run_to_run_and_unacknowledged_events_are_sent_again(
    tmp_path: Path,
) -> None:
    path, epochs = tmp_path / "o.sqlite", list[str]()
    async with opened(path) as box:
        await box.append([DRAFT] * 3)
        await box.append([DRAFT])
        assert box.waiting == 4
        assert len(await send(box, 4)) == 4
        await box.append([DRAFT] * 2)
        epochs.append(box.epoch)
        assert box.heads() == [(box.epoch, 4)]
    async with opened(path) as box:
        await box.append([DRAFT])
        assert box.waiting == 3
        assert await send(box) == [f"{epochs[0]}-{seq}" for seq in (5, 6, 7)]
        assert box.heads() == [(epochs[0], 7)]
        assert not await box.next(10)
    async with opened(path) as box:
        await until(lambda: box.waiting == 0)


async def test_entries_are_returned_once_and_after_a_rewind_the_unacknowledged_ones(
    tmp_path: Path,
) -> None:
    async with opened(tmp_path / "o.sqlite") as box:
        await box.append([DRAFT] * 600)  # more than stay in memory
        entries = [*await box.next(400), *await box.next(400)]
        assert [entry.seq for entry in entries] == list(range(1, 601))
        assert not await box.next(1)
        box.acknowledge([entry for entry in entries if entry.seq % 100])
        box.rewind()
        found = list[int]()
        while entries := await box.next(4):
            found += [entry.seq for entry in entries]
        assert found == [100, 200, 300, 400, 500, 600]
        box.rewind(350)
        assert [entry.seq for entry in await box.next(2)] == [400, 500]


async def test_a_range_is_returned_with_the_last_number_covered(tmp_path: Path) -> None:
    async with opened(tmp_path / "o.sqlite") as box:
        await box.append([DRAFT] * 600)
        for first, last, limit, expected, far in (
            (5, 7, 10, [5, 6, 7], 7),
            (5, 900, 3, [5, 6, 7], 7),
            (598, 900, 10, [598, 599, 600], 600),
            (601, 900, 10, [], 600),
        ):
            entries, reached = await box.between(box.epoch, first, last, limit)
            assert ([entry.seq for entry in entries], reached) == (expected, far)
        assert await box.between("unknown", 3, 9, 10) == ([], 9)


async def test_old_events_are_pruned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outbox, "ACKNOWLEDGE_EVERY", 0.0)
    async with opened(tmp_path / "o.sqlite", keep=10) as box:
        await box.append([DRAFT] * 50)
        await box.append([DRAFT] * 5)
        box.acknowledge(await box.next(50))
        entries, _ = await box.between(box.epoch, 1, 100, 100)
        for _ in range(1000):
            if len(entries) < 55:
                break
            await asyncio.sleep(0.01)
            entries, _ = await box.between(box.epoch, 1, 100, 100)
        assert [entry.seq for entry in entries] == list(range(46, 56))


FULL = sqlite3.OperationalError("database or disk is full")


async def test_events_from_memory_have_their_own_epoch_and_are_stored_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    path, sent, epochs = tmp_path / "o.sqlite", list[str](), list[str]()
    async with opened(path) as box:
        await box.append([DRAFT] * 2)
        epochs.append(box.epoch)
        failing = Failing(monkeypatch, FULL)
        await box.append([DRAFT] * 2)
        await box.append([DRAFT])
        epochs.append(box.epoch)
        assert box.error == "cannot be used: database or disk is full"
        sent.extend(await send(box, 4))
        with pytest.raises(EndpointError):
            await box.between(epochs[0], 1, 2, 10)
        failing.error = None
        await until(lambda: not box.error)
        await box.append([DRAFT])
        assert box.heads() == [(epochs[0], 2), (epochs[1], 2)]
        sent.extend(await send(box))
        assert box.waiting == 0
    first, second = epochs
    assert first != second
    assert sent == [f"{first}-{seq}" for seq in (1, 2)] + [f"{second}-{seq}" for seq in (1, 2, 3, 4)]
    async with opened(path) as box:
        kept = [await box.between(epoch, 1, 9, 10) for epoch in epochs]
        assert [[entry.seq for entry in entries] for entries, _ in kept] == [[1, 2], [1, 2, 3, 4]]
        assert (box.epoch, box.waiting) == (second, 0)
    assert [record.levelname for record in caplog.records] == ["ERROR", "WARNING"]


async def test_a_hanging_disk_delays_no_event_and_no_number_is_used_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outbox, "WRITE_TIMEOUT", 0.05)
    stuck, append = threading.Event(), OutboxFile.append

    def slow(file: OutboxFile, *args: Any) -> None:  # noqa: ANN401
        assert stuck.wait(PATIENCE)
        append(file, *args)

    async with opened(tmp_path / "o.sqlite") as box:
        await box.append([DRAFT])
        monkeypatch.setattr(OutboxFile, "append", slow)
        before = box.epoch
        await box.append([DRAFT])
        assert box.error == "the disk does not respond"
        [_, late] = [*await box.next(1), *await box.next(1)]
        assert (late.epoch, late.seq) == (box.epoch, 1)
        stuck.set()
        await until(lambda: not box.error)
        assert [entry.seq for entry in (await box.between(before, 1, 9, 9))[0]] == [1]
        assert [entry.seq for entry in (await box.between(box.epoch, 1, 9, 9))[0]] == [1]


async def test_memory_is_bounded_while_the_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outbox, "MEMORY_MAX", 10)
    async with opened(tmp_path / "o.sqlite") as box:
        failing = Failing(monkeypatch, FULL)
        await box.append([DRAFT] * 10)
        with pytest.raises(EndpointError, match="memory is full with 10 unsent events"):
            await box.append([DRAFT])
        await send(box)
        await box.append([DRAFT])  # in place of one that the broker has
        assert [entry.seq for entry in await box.next(9)] == [11]
        failing.error = None


async def test_an_outbox_opens_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, full = tmp_path / "o.sqlite", [True]
    async with opened(path) as box:
        await box.append([DRAFT] * 3)
    init = OutboxFile.__init__

    def fail(self: OutboxFile, path: Path) -> None:
        if full:
            raise OSError(28, "No space left on device")
        init(self, path)

    monkeypatch.setattr(OutboxFile, "__init__", fail)
    async with opened(path) as box:
        full.clear()
        await until(lambda: not box.error)
        (before, _), _ = box.heads()
        assert [entry.seq for entry in (await box.between(before, 1, 9, 9))[0]] == [1, 2, 3]
        full.append(True)
    async with opened(path) as box:
        await box.append([DRAFT])
        assert [entry.seq for entry in await box.next(9)] == [1]
        full.clear()
        await until(lambda: not box.error)
        assert box.waiting == 4
        assert len(box.heads()) == 3  # a run each
        assert [entry.seq for entry in await box.next(9)] == [1, 2, 3, 1]


async def test_a_file_damaged_in_use_is_renamed_and_events_continue(tmp_path: Path) -> None:
    path = tmp_path / "o.sqlite"
    async with opened(path) as box:
        await box.append([DRAFT] * 600)
        await until(lambda: len(inside(box, "_memory")) < 300)
        before = box.epoch
        inside(box, "_file", "_db").execute("UPDATE events SET payload = x'00' WHERE id = 17")
        sent = await send(box)
        assert box.error == "cannot be used: a row has a wrong checksum"
        assert sent  # what was in memory
        await until(lambda: not box.error)
        sent += await send(box)
        assert sorted(sent) == sorted(f"{before}-{seq}" for seq in range(1, 601) if seq != 17)
        assert box.epoch != before
        assert [seq for seq in range(1, 601) if not (await box.between(before, seq, seq, 1))[0]] == [17]
    assert list(tmp_path.glob("o.sqlite.damaged-*"))


async def test_a_cancelled_append_stores_all_events_or_none(tmp_path: Path) -> None:
    async with opened(tmp_path / "o.sqlite") as box:
        for turns in range(6):
            writing = asyncio.create_task(box.append([DRAFT, DRAFT]))
            for _ in range(turns):
                await asyncio.sleep(0)
            writing.cancel()
            await asyncio.wait([writing])
        await box.append([DRAFT])
        numbers = [int(each.rpartition("-")[2]) for each in await send(box)]
        assert numbers == list(range(1, len(numbers) + 1))
        assert len(numbers) % 2


async def test_a_file_in_use_is_an_error_with_a_remedy(tmp_path: Path) -> None:
    async with opened(tmp_path / "o.sqlite"):
        with pytest.raises(EndpointError, match=r"is in use: .* name another rig or outbox"):
            await Outbox(tmp_path / "o.sqlite", keep=1, keep_for=1).open()
    async with opened(tmp_path / "o.sqlite") as box:
        await box.append([DRAFT])


async def test_a_path_that_cannot_be_an_outbox_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(EndpointError, match=r"o\.sqlite: cannot be used: "):
        async with opened(tmp_path / "file" / "o.sqlite") as box:
            await box.append([])
    other = sqlite3.connect(tmp_path / "other.sqlite")
    other.execute("CREATE TABLE precious (x)")
    other.close()
    with pytest.raises(InputError, match="is not an outbox"):
        async with opened(tmp_path / "other.sqlite") as box:
            await box.append([])


def cut(path: Path, to: Path) -> None:
    """What is on the disk just now."""
    for part in ("", "-wal"):
        shutil.copy(f"{path}{part}", f"{to}{part}")


def durable(box: Outbox) -> bool:
    return bool(inside(box, "_durable") == inside(box, "_written"))


async def test_after_a_power_cut_no_number_is_used_twice_and_lost_events_are_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, sent, epochs = tmp_path / "o.sqlite", list[str](), list[str]()

    async def go_on(box: Outbox) -> None:
        await box.append([DRAFT])
        epochs.append(box.epoch)
        sent.extend(await send(box))

    async with opened(path) as box:
        await box.append([DRAFT] * 5)
        await until(lambda: durable(box))
        cut(path, tmp_path / "cut.sqlite")
        await box.append([DRAFT] * 3)
        cut(path, tmp_path / "killed.sqlite")
        sent.extend(await send(box))
        epochs.append(box.epoch)
    async with opened(tmp_path / "killed.sqlite") as box:
        await go_on(box)
    assert sent[-1] == f"{epochs[0]}-9"
    monkeypatch.setattr(outbox, "boot_id", lambda: "the next")
    async with opened(path) as box:
        await go_on(box)
    assert sent[-1] == f"{epochs[0]}-9"
    async with opened(tmp_path / "cut.sqlite") as box:
        await go_on(box)
        assert sent[-1] == f"{box.epoch}-1"
        assert box.heads() == [(epochs[0], 5), (box.epoch, 1)]
        assert await box.between(epochs[0], 6, 8, 10) == ([], 8)
        entries, reached = await box.between(epochs[0], 4, 8, 10)
        assert ([entry.seq for entry in entries], reached) == ([4, 5], 8)
    assert epochs[3] != epochs[0] == epochs[1] == epochs[2]


async def test_the_mark_that_numbers_may_be_lost_is_written_before_the_first_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, epochs = tmp_path / "o.sqlite", list[str]()

    async def body(box: Outbox) -> None:
        cut(box.path, tmp_path / f"{len(epochs)}.sqlite")
        epochs.append(box.epoch)

    async with opened(path) as box:
        await body(box)
    monkeypatch.setattr(outbox, "boot_id", lambda: "the next")
    async with opened(path) as box:
        await body(box)
    async with opened(tmp_path / "0.sqlite") as box:
        await body(box)
    monkeypatch.setattr(outbox, "boot_id", lambda: "the one after")
    async with opened(tmp_path / "1.sqlite") as box:
        await body(box)
    assert epochs[0] == epochs[1]
    assert len(set(epochs)) == 3


async def test_events_do_not_wait_for_fsync(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stuck, sync = threading.Event(), OutboxFile.sync

    def slow(file: OutboxFile) -> None:
        assert stuck.wait(PATIENCE)
        sync(file)

    async with opened(tmp_path / "o.sqlite") as box:
        monkeypatch.setattr(OutboxFile, "sync", slow)
        for _ in range(600):
            await box.append([DRAFT])
        assert len(await send(box)) == 600
        assert len(inside(box, "_memory")) == 600
        stuck.set()
        await until(lambda: len(inside(box, "_memory")) < 300)
        assert not box.error


async def test_events_whose_fsync_failed_are_written_again_with_their_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failures, sync = [OSError(5, "Input/output error")], OutboxFile.sync

    def fail(file: OutboxFile) -> None:
        if failures:
            raise failures.pop()
        sync(file)

    async with opened(tmp_path / "o.sqlite") as box:
        before = box.epoch
        monkeypatch.setattr(OutboxFile, "sync", fail)
        await box.append([DRAFT] * 3)
        await until(lambda: bool(box.error))
        await box.append([DRAFT])
        await until(lambda: not box.error and durable(box))
        inside(box, "_memory").clear()
        kept = {epoch: (await box.between(epoch, 1, 9, 10))[0] for epoch in (before, box.epoch)}
        assert [[entry.seq for entry in entries] for entries in kept.values()] == [[1, 2, 3], [1]]
        assert sorted(await send(box)) == sorted(
            [*(f"{before}-{seq}" for seq in (1, 2, 3)), f"{box.epoch}-1"]
        )


async def test_a_failure_during_a_write_preserves_all_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writing, go, append = threading.Event(), threading.Event(), OutboxFile.append

    def slow(file: OutboxFile, *args: Any) -> None:  # noqa: ANN401
        writing.set()
        assert go.wait(PATIENCE)
        append(file, *args)

    async with opened(tmp_path / "o.sqlite") as box:
        await box.append([DRAFT])
        before = box.epoch
        monkeypatch.setattr(OutboxFile, "append", slow)
        coming = asyncio.create_task(box.append([DRAFT] * 2))
        await asyncio.to_thread(writing.wait)
        vars(Outbox)["_fail"](box, EndpointError("o", "is out of order"))
        go.set()
        await coming
        await box.append([DRAFT])
        await until(lambda: not box.error)
        assert box.heads() == [(before, 0), (box.epoch, 0)]
        found = await send(box)
        assert sorted(found) == sorted([*(f"{before}-{seq}" for seq in (1, 2, 3)), f"{box.epoch}-1"])
        inside(box, "_memory").clear()
        assert [entry.seq for entry in (await box.between(before, 1, 9, 9))[0]] == [1, 2, 3]


async def test_events_written_during_a_failure_are_kept_with_earlier_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failing, writing, go = threading.Event(), threading.Event(), threading.Event()
    append, sync, failures = OutboxFile.append, OutboxFile.sync, [OSError(5, "Input/output error")]

    def fail(file: OutboxFile) -> None:
        if failures:
            assert failing.wait(PATIENCE)
            raise failures.pop()
        sync(file)

    def slow(file: OutboxFile, *args: Any) -> None:  # noqa: ANN401
        writing.set()
        assert go.wait(PATIENCE)
        append(file, *args)

    async with opened(tmp_path / "o.sqlite") as box:
        before = box.epoch
        monkeypatch.setattr(OutboxFile, "sync", fail)
        await box.append([DRAFT])
        monkeypatch.setattr(OutboxFile, "append", slow)
        coming = asyncio.create_task(box.append([DRAFT] * 2))
        await asyncio.to_thread(writing.wait)
        failing.set()
        await until(lambda: bool(box.error))
        go.set()
        await coming
        await until(lambda: not box.error and durable(box))
        inside(box, "_memory").clear()
        assert [entry.seq for entry in (await box.between(before, 1, 9, 9))[0]] == [1, 2, 3]


async def test_the_write_ahead_log_is_checkpointed_when_idle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outbox, "ACKNOWLEDGE_EVERY", 0.0)
    emptied, checkpoint = threading.Event(), OutboxFile.checkpoint

    def noted(file: OutboxFile) -> None:
        checkpoint(file)
        emptied.set()

    path = tmp_path / "o.sqlite"
    async with opened(path) as box:
        monkeypatch.setattr(OutboxFile, "checkpoint", noted)
        await box.append([DRAFT] * 600)
        await send(box)
        assert await asyncio.to_thread(emptied.wait, PATIENCE)
        assert path.stat().st_size > 600 * 200


def test_without_a_boot_id_every_run_counts_as_a_new_boot(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(path: Path, **_: str) -> str:
        raise FileNotFoundError(path)

    monkeypatch.setattr(Path, "read_text", fail)
    assert outbox.boot_id() != outbox.boot_id()
