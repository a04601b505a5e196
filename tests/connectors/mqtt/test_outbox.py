import asyncio
import errno
import random
import shutil
import threading
from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager, suppress
from errno import EIO, ENOSPC
from pathlib import Path
from typing import Any

import pytest

from connectors.events import Event
from connectors.mqtt import outbox, outbox_log
from connectors.mqtt.outbox import Outbox
from operators.errors import EndpointError, InputError
from storage import files
from storage.append_log import AppendLog, LogReader
from tests.inside import inside
from tests.waiting import PATIENCE, until

DRAFT = Event("lab", "rig", "0", "", 0, onset=True, time=1, probability=0.9, latency=1.0)


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Segments and a cache of few events, and short pauses."""
    monkeypatch.setattr(outbox_log, "SEGMENT_EVENTS", 10)
    monkeypatch.setattr(outbox, "CACHED", 4)
    monkeypatch.setattr(outbox, "ACKNOWLEDGE_EVERY", 0.0)


class Disk:
    """Disk whose writes and fsyncs fail or wait."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.write_error: OSError | None = None
        self.sync_error: OSError | None = None
        self.writes, self.syncs = threading.Event(), threading.Event()  # cleared: they hang
        self.writes.set()
        self.syncs.set()
        append, sync, create = AppendLog.append, AppendLog.sync, vars(AppendLog)["create"].__func__

        def failing_append(log: AppendLog, records: Iterable[bytes]) -> list[int]:
            assert self.writes.wait(PATIENCE)
            if self.write_error:
                raise self.write_error
            return append(log, records)

        def failing_sync(log: AppendLog) -> None:
            assert self.syncs.wait(PATIENCE)
            if self.sync_error:
                log.suspect = True
                raise self.sync_error
            sync(log)

        def failing_create(kind: type[AppendLog], *arguments: Any) -> AppendLog:  # noqa: ANN401
            if self.write_error or self.sync_error:
                raise self.write_error or self.sync_error or OSError()
            log: AppendLog = create(kind, *arguments)
            return log

        monkeypatch.setattr(AppendLog, "append", failing_append)
        monkeypatch.setattr(AppendLog, "sync", failing_sync)
        monkeypatch.setattr(AppendLog, "create", classmethod(failing_create))


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    return Disk(monkeypatch)


@asynccontextmanager
async def opened(path: Path, keep: int = 1000) -> AsyncGenerator[Outbox]:
    box = Outbox(path, keep=keep, keep_for=1e9)
    await box.open()
    try:
        yield box
    finally:
        await box.close()


async def send(box: Outbox, limit: int = 1000) -> list[str]:
    """Take the pending events, and acknowledge them."""
    found = list[str]()
    while entries := await box.next(min(limit, 100)):
        found += [Event.decode(entry.payload).identifier for entry in entries]
        box.acknowledge(entries)
        limit -= len(entries)
        if limit <= 0:
            break
    return found


async def kept(box: Outbox, epoch: str) -> list[int]:
    """The numbers of an epoch that the outbox still stores."""
    found, first = list[int](), 1
    while first < 2000:
        entries, last = await box.between(epoch, first, 2000, 100)
        found += [Event.decode(entry.payload).seq for entry in entries]
        if last < first:
            break
        first = last + 1
    return found


def names(epoch: str, numbers: Iterable[int]) -> list[str]:
    return [f"{epoch}-{number}" for number in numbers]


async def test_numbers_continue_from_run_to_run_and_unacknowledged_events_are_sent_again(
    tmp_path: Path,
) -> None:
    path = tmp_path / "outbox"
    async with opened(path) as box:
        epoch = box.epoch
        await box.append([DRAFT] * 3)
        await box.append([DRAFT])
        assert box.waiting == 4
        assert await send(box, 4) == names(epoch, range(1, 5))
        await box.append([DRAFT] * 20)
        assert box.heads() == [(epoch, 4)]
    async with opened(path) as box:
        await box.append([DRAFT])
        assert box.waiting == 21
        assert await send(box) == names(epoch, range(5, 26))
        assert box.heads() == [(epoch, 25)]
    async with opened(path) as box:
        assert (box.epoch, box.waiting, box.heads()) == (epoch, 0, [(epoch, 25)])


async def test_entries_are_returned_once_and_after_a_rewind_the_unacknowledged_ones(tmp_path: Path) -> None:
    async with opened(tmp_path / "outbox") as box:
        await box.append([DRAFT] * 60)
        entries = [*await box.next(40), *await box.next(40)]
        assert [entry.seq for entry in entries] == list(range(1, 61))
        assert not await box.next(1)
        box.acknowledge([entry for entry in entries if entry.seq % 10])
        box.rewind()
        assert [[entry.seq for entry in await box.next(4)] for _ in range(2)] == [[10, 20, 30, 40], [50, 60]]


async def test_a_range_is_returned_with_the_last_number_covered(tmp_path: Path) -> None:
    async with opened(tmp_path / "outbox") as box:
        await box.append([DRAFT] * 60)
        await until(lambda: len(inside(box, "_memory")) == outbox.CACHED)
        for first, last, limit, expected, covered in (
            (5, 7, 10, [5, 6, 7], 7),
            (5, 900, 3, [5, 6, 7], 7),
            (55, 900, 10, [55, 56, 57, 58, 59, 60], 60),
            (61, 900, 10, [], 60),
        ):
            entries, reached = await box.between(box.epoch, first, last, limit)
            assert ([entry.seq for entry in entries], reached) == (expected, covered)
        assert await box.between("unknown", 3, 9, 10) == ([], 9)


async def test_only_old_acknowledged_events_are_pruned(tmp_path: Path) -> None:
    async with opened(tmp_path / "outbox", keep=20) as box:
        for _ in range(9):
            await box.append([DRAFT] * 10)
        assert await kept(box, box.epoch) == list(range(1, 91))
        await send(box, 85)
        await until(lambda: inside(box, "_log").first == 71)
        assert await kept(box, box.epoch) == list(range(71, 91))
        assert await send(box) == names(box.epoch, range(86, 91))
    async with opened(tmp_path / "outbox", keep=20) as box:
        assert await kept(box, box.epoch) == list(range(71, 91))
        assert box.waiting == 0


def snapshot(path: Path, name: str) -> Path:
    """Return a copy of a folder as a crash at this moment would leave it."""
    return Path(shutil.copytree(path, path.with_name(name)))


async def test_after_a_crash_a_new_epoch_begins_and_no_event_is_lost(tmp_path: Path) -> None:
    async with opened(tmp_path / "outbox") as box:
        first = box.epoch
        await box.append([DRAFT] * 25)
        await send(box, 12)
        await until(lambda: not len(inside(box, "_unsaved")))
        crashed = snapshot(tmp_path / "outbox", "crashed")
    [*_, newest] = sorted(crashed.iterdir())
    newest.write_bytes(newest.read_bytes()[:-3])  # a torn record
    async with opened(crashed) as box:
        assert box.epoch != first
        assert box.heads()[1] == (box.epoch, 0)
        await box.append([DRAFT] * 2)
        sent = await send(box)
        assert sent[-2:] == names(box.epoch, (1, 2))
        assert {*names(first, range(13, 26))} <= {*sent[:-2]} | {*names(first, (25,))}
        assert (await kept(box, first))[:24] == list(range(1, 25))
        second = snapshot(crashed, "again")
    async with opened(second) as box:
        assert len(box.heads()) == 3


async def test_an_epoch_does_not_continue_if_a_power_cut_may_have_lost_its_numbers(tmp_path: Path) -> None:
    async with opened(tmp_path / "outbox") as box:
        epoch = box.epoch
        await box.append([DRAFT])
    async with opened(tmp_path / "outbox") as box:
        assert box.epoch == epoch
        lost = snapshot(tmp_path / "outbox", "lost")  # the power fails before the next event is durable
        await box.append([DRAFT])
    async with opened(lost) as box:
        assert box.epoch != epoch


async def test_a_failing_disk_stops_no_event_and_gets_them_all_later(
    tmp_path: Path, disk: Disk, caplog: pytest.LogCaptureFixture
) -> None:
    async with opened(tmp_path / "outbox") as box:
        await box.append([DRAFT] * 8)
        disk.write_error = OSError(ENOSPC, "No space left on device")
        await box.append([DRAFT] * 2)
        await box.append([DRAFT])
        assert box.error.startswith("cannot be written: No space left on device; free")
        assert (box.unstored, len(await send(box, 10))) == (3, 10)
        assert box.unstored == 1  # the others need no disk
        disk.write_error = None
        await until(lambda: not box.error)
        assert (box.unstored, await send(box)) == (0, names(box.epoch, [11]))
        assert await kept(box, box.epoch) == list(range(1, 12))
    async with opened(tmp_path / "outbox") as box:
        assert await kept(box, box.epoch) == list(range(1, 12))
    assert [record.levelname for record in caplog.records] == ["ERROR", "WARNING"]


async def test_a_hanging_disk_delays_no_event_for_long(
    tmp_path: Path, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outbox, "WRITE_TIMEOUT", 0.05)
    async with opened(tmp_path / "outbox") as box:
        disk.writes.clear()
        await box.append([DRAFT])
        assert box.error == "the disk does not respond"
        assert await send(box) == names(box.epoch, [1])
        disk.writes.set()
        await until(lambda: not box.error)
        assert await kept(box, box.epoch) == [1]


async def test_memory_is_bounded_while_the_disk_is_full(
    tmp_path: Path, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outbox, "MEMORY_MAX", 10)
    async with opened(tmp_path / "outbox") as box:
        disk.write_error = OSError(ENOSPC, "No space left on device")
        await box.append([DRAFT] * 10)
        with pytest.raises(EndpointError, match="memory is full with 10 unsent events"):
            await box.append([DRAFT])
        await send(box)
        await box.append([DRAFT])  # in place of one that the broker has
        assert [entry.seq for entry in await box.next(9)] == [11]
        disk.write_error = None


async def test_an_outbox_opens_on_a_full_disk_in_a_new_epoch(tmp_path: Path, disk: Disk) -> None:
    path, full = tmp_path / "outbox", OSError(ENOSPC, "No space left on device")
    disk.write_error = full
    async with opened(path) as box:
        await box.append([DRAFT] * 3)
        disk.write_error = None
        await until(lambda: not box.error)
        first = box.epoch
    disk.write_error = full
    async with opened(path) as box:
        await box.append([DRAFT])
        assert box.epoch != first
        assert await send(box) == [*names(first, (1, 2, 3)), *names(box.epoch, [1])]
        disk.write_error = None
        await until(lambda: not box.error)
        assert await kept(box, first) == [1, 2, 3]


@pytest.mark.parametrize("late", [False, True])  # the fsync reports its failure after the write
async def test_events_are_written_again_if_an_fsync_fails_during_a_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, late: bool
) -> None:
    failed, reported, proceed = threading.Event(), threading.Event(), threading.Event()
    sync, append = AppendLog.sync, AppendLog.append

    def failing_sync(log: AppendLog) -> None:
        if failed.is_set():
            sync(log)
            return
        log.suspect = True
        failed.set()
        assert proceed.wait(PATIENCE)
        raise OSError(errno.EIO, "failed")

    def slow_append(log: AppendLog, records: Iterable[bytes]) -> list[int]:
        if failed.is_set() and not late:
            proceed.set()
            assert reported.wait(PATIENCE)
        return append(log, records)

    async with opened(tmp_path / "outbox") as box:
        monkeypatch.setattr(AppendLog, "sync", failing_sync)
        await box.append([DRAFT] * 5)
        await asyncio.to_thread(failed.wait, PATIENCE)
        monkeypatch.setattr(AppendLog, "append", slow_append)
        adding = asyncio.create_task(box.append([DRAFT] * 2))
        if late:
            await adding
            proceed.set()
        else:
            await until(lambda: bool(box.error))
            reported.set()
        await adding
        await until(lambda: inside(box, "_durable") == 7)
        assert inside(box, "_log", "_segments")[-1].ids.tolist() == [*range(1, 8)]


async def test_a_record_damaged_in_use_costs_one_event(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async with opened(tmp_path / "outbox") as box:
        await box.append([DRAFT] * 30)
        await until(lambda: len(inside(box, "_memory")) == outbox.CACHED)
        damaged = inside(box, "_log", "_segments")[0]
        flip(damaged.path, damaged.offsets[6] + 50)
        assert await send(box) == names(box.epoch, [*range(1, 7), *range(8, 31)])
        assert await kept(box, box.epoch) == [*range(1, 7), *range(8, 31)]
    assert caplog.messages == [f"{tmp_path}/outbox: event 7 of epoch {box.epoch} is damaged and lost"]


def flip(path: Path, at: int) -> None:
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize("crashed", [False, True])
async def test_a_flipped_bit_never_invents_an_event_or_reuses_a_number(
    tmp_path: Path, *, crashed: bool
) -> None:
    async with opened(tmp_path / "outbox") as box:
        epoch = box.epoch
        await box.append([DRAFT] * 25)
        await send(box, 5)
        if crashed:
            source = snapshot(tmp_path / "outbox", "source")
        sent = {Event.decode(entry.payload).identifier: entry.payload for entry in await box.next(100)}
    source = tmp_path / ("source" if crashed else "outbox")
    chance = random.Random(crashed)  # noqa: S311 - not for secrets
    for turn in range(12):
        copy = snapshot(source, f"copy{turn}")
        path = chance.choice(sorted(copy.iterdir()))
        flip(path, chance.randrange(path.stat().st_size))
        async with opened(copy) as box:
            await box.append([DRAFT])
            while entries := await box.next(100):
                for entry in entries:
                    identifier = Event.decode(entry.payload).identifier
                    assert entry.payload == sent.get(identifier, entry.payload)
                    assert (
                        identifier in sent
                        or identifier in (*names(box.epoch, [1]), f"{epoch}-26")
                        or (int(identifier.rpartition("-")[2]) <= 5)
                    )


@pytest.mark.parametrize("new_segment", [False, True])
async def test_numbers_of_a_run_are_not_reused_if_its_first_record_is_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, new_segment: bool
) -> None:
    async with opened(tmp_path / "outbox") as box:
        await box.append([DRAFT] * 3)
    [before] = (tmp_path / "outbox").iterdir()
    size = before.stat().st_size
    if new_segment:
        monkeypatch.setattr(outbox_log, "SEGMENT_SPAN", -1e9)  # s
    async with opened(tmp_path / "outbox") as box:
        used = box.epoch
        await box.append([DRAFT] * 3)
    if new_segment:
        for path in set((tmp_path / "outbox").iterdir()) - {before}:
            flip(path, 12)  # in its header
    else:
        flip(before, size + 12)
    async with opened(tmp_path / "outbox") as box:
        assert box.epoch != used


async def test_a_damaged_segment_costs_only_its_rest_and_is_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async with opened(tmp_path / "outbox") as box:
        for _ in range(3):
            await box.append([DRAFT] * 10)
        offset = inside(box, "_log", "_segments")[0].offsets[6]
    [first, *_] = sorted((tmp_path / "outbox").iterdir())
    flip(first, offset + 50)
    async with opened(tmp_path / "outbox") as box:
        assert await kept(box, box.epoch) == [*range(1, 7), *range(11, 31)]
        assert len(await send(box)) == 26
    assert caplog.messages == [
        f"{first}: damaged at byte {offset}; the rest of it is lost",
        f"{tmp_path}/outbox: 4 events cannot be read and are lost",
    ]


async def test_a_cancelled_append_stores_all_events_or_none(tmp_path: Path) -> None:
    async with opened(tmp_path / "outbox") as box:
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


async def test_an_outbox_in_use_is_an_error_with_a_remedy(tmp_path: Path) -> None:
    async with opened(tmp_path / "outbox"):
        with pytest.raises(EndpointError, match=r"is in use: .* name another rig or outbox"):
            await Outbox(tmp_path / "outbox", keep=1, keep_for=1).open()
    async with opened(tmp_path / "outbox") as box:
        await box.append([DRAFT])


async def test_a_path_that_cannot_be_an_outbox_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(EndpointError, match=r"outbox: cannot be used: Not a directory"):
        await Outbox(tmp_path / "file" / "outbox", keep=1, keep_for=1).open()
    with pytest.raises(InputError, match=r"file: is a file, must be a folder: name another outbox"):
        await Outbox(tmp_path / "file", keep=1, keep_for=1).open()
    (tmp_path / "other").mkdir()
    AppendLog.create(tmp_path / "other" / "1.log", b"precious").close()
    with pytest.raises(InputError, match="is not part of an outbox"):
        await Outbox(tmp_path / "other", keep=1, keep_for=1).open()


async def test_events_do_not_wait_for_fsync(tmp_path: Path, disk: Disk) -> None:
    async with opened(tmp_path / "outbox") as box:
        disk.syncs.clear()
        for _ in range(9):
            await box.append([DRAFT])
        assert len(await send(box)) == 9
        assert len(inside(box, "_memory")) == 9
        disk.syncs.set()
        await until(lambda: len(inside(box, "_memory")) == outbox.CACHED)
        assert not box.error


async def test_events_whose_fsync_failed_are_written_again(tmp_path: Path, disk: Disk) -> None:
    async with opened(tmp_path / "outbox") as box:
        await box.append([DRAFT] * 3)
        await until(lambda: inside(box, "_durable") == 3)
        disk.sync_error = OSError(EIO, "Input/output error")
        await box.append([DRAFT] * 3)
        await until(lambda: bool(box.error))
        await box.append([DRAFT])
        disk.sync_error = None
        await until(lambda: not box.error and inside(box, "_durable") == 7)
        [first, second] = inside(box, "_log", "_segments")
        assert [*second.ids] == [4, 5, 6, 7]
        first.path.write_bytes(first.path.read_bytes()[: first.offsets[3]])  # the kernel dropped the pages
        inside(box, "_memory").clear()
        assert await send(box) == names(box.epoch, range(1, 8))
        epoch = box.epoch
    async with opened(tmp_path / "outbox") as box:
        assert (await kept(box, epoch), box.waiting) == (list(range(1, 8)), 0)


async def test_a_failed_write_that_cannot_be_undone_costs_no_event(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_at, failing = files.write_at, [True]

    def fail(descriptor: int, data: bytes | memoryview, offset: int) -> int:
        if failing:
            write_at(descriptor, data[:7], offset)
            raise OSError(EIO, "Input/output error")
        return write_at(descriptor, data, offset)

    def refuse(*_: int) -> None:
        raise OSError(EIO, "Input/output error")

    async with opened(tmp_path / "outbox") as box:
        await box.append([DRAFT] * 3)
        monkeypatch.setattr(files, "write_at", fail)
        monkeypatch.setattr(files, "truncate", refuse)
        await box.append([DRAFT] * 2)
        failing.clear()
        await until(lambda: not box.error)
        epoch = box.epoch
    async with opened(tmp_path / "outbox") as box:
        assert (await kept(box, epoch), box.epoch) == ([1, 2, 3, 4, 5], epoch)


async def test_a_segment_without_a_readable_header_is_kept_under_another_name(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async with opened(tmp_path / "outbox") as box:
        await box.append([DRAFT] * 3)
        epoch = box.epoch
    [path] = (tmp_path / "outbox").iterdir()
    flip(path, 10)
    for _ in range(2):
        async with opened(tmp_path / "outbox") as box:
            await box.append([DRAFT])
            assert box.epoch != epoch
    assert path.with_suffix(".damaged").exists()
    assert len(caplog.messages) == 1


async def test_an_orderly_close_waits_for_a_slow_disk(
    tmp_path: Path, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outbox, "WRITE_TIMEOUT", 0.01)
    monkeypatch.setattr(outbox, "LAST_ATTEMPTS", 0.0)
    box = Outbox(tmp_path / "outbox", keep=1, keep_for=1)
    await box.open()
    disk.writes.clear()
    for _ in range(3):
        await box.append([DRAFT] * 100)
    closing = asyncio.create_task(box.close())
    with suppress(TimeoutError):
        await asyncio.wait_for(asyncio.shield(closing), 0.1)
    assert (closing.done(), box.unstored) == (False, 300)
    disk.writes.set()
    await closing
    assert box.unstored == 0
    async with opened(tmp_path / "outbox") as again:
        assert (again.waiting, again.epoch) == (300, box.epoch)


@pytest.mark.parametrize("hangs", [False, True])
async def test_losses_of_an_ended_close_are_exact(
    tmp_path: Path,
    disk: Disk,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    *,
    hangs: bool,
) -> None:
    monkeypatch.setattr(outbox, "WRITE_TIMEOUT", 0.01)
    monkeypatch.setattr(outbox, "LAST_ATTEMPTS", 0.0)
    box = Outbox(tmp_path / "outbox", keep=1, keep_for=1)
    await box.open()
    await box.append([DRAFT] * 5)
    if hangs:
        disk.writes.clear()
    else:
        disk.write_error = OSError(EIO, "Input/output error")
    await box.append([DRAFT] * 7)
    box.acknowledge((await box.next(8))[:6])
    await box.append([DRAFT] * 3)
    closing = asyncio.create_task(box.close())
    await asyncio.sleep(0.01)
    if hangs:  # a second signal ends it, after the write in progress
        closing.cancel()
        await asyncio.sleep(0.01)
        disk.writes.set()
    await asyncio.wait([closing])
    lost = 3 if hangs else 9
    assert box.unstored == lost
    assert caplog.messages[-1].endswith(f"{lost} events are lost")
    with LogReader(next((tmp_path / "outbox").iterdir())) as reader:
        events = [record for record in reader.records() if b"specversion" in record.data]
    assert len(events) == (12 if hangs else 5)


@pytest.mark.virtual
async def test_events_are_sent_from_memory_after_the_task_that_writes_them_has_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def fail(box: Outbox) -> None:
        del box
        await asyncio.sleep(0.5)
        raise KeyError("planted")

    monkeypatch.setattr(Outbox, "_keep_writing", fail)
    box = Outbox(tmp_path / "outbox", keep=1000, keep_for=1e9)
    await box.open()
    await box.append([DRAFT, DRAFT])
    assert "the writing of events has failed: KeyError: 'planted'" in caplog.text
    assert len(await send(box)) == 2
    await box.append([DRAFT])
    with pytest.raises(EndpointError, match="the writing of events has failed"):
        await box.close()
    assert "1 events are lost" in caplog.text
    assert asyncio.get_running_loop().time() < 5.0


async def test_events_are_durable_at_the_end_although_the_task_that_syncs_them_has_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def end_early(box: Outbox) -> None:
        del box

    with monkeypatch.context() as patch:
        patch.setattr(Outbox, "_keep_syncing", end_early)
        box = Outbox(tmp_path / "outbox", keep=1000, keep_for=1e9)
        await box.open()
        await box.append([DRAFT])
        assert "the fsync of events has failed" in caplog.text
        with pytest.raises(EndpointError, match="the fsync of events has failed: it ended early"):
            await box.close()
    async with opened(tmp_path / "outbox") as after:
        assert after.epoch == box.epoch
        assert len(await send(after)) == 1
