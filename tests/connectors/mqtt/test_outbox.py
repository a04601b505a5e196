import asyncio
import logging
import threading
from collections.abc import Iterable, Iterator
from errno import ENOSPC
from pathlib import Path

import pytest

from connectors.events import Event
from connectors.mqtt import outbox, outbox_log
from connectors.mqtt.outbox import Outbox
from operators.errors import EndpointError, InputError
from storage.append_log import AppendLog
from tests.connectors.mqtt.made import EVENT, opened
from tests.inside import inside
from tests.storage.disk_steps import observed
from tests.storage.made import flip
from tests.waiting import PATIENCE, until


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Segments of few events, and short pauses."""
    monkeypatch.setattr(outbox_log, "SEGMENT_EVENTS", 10)
    monkeypatch.setattr(outbox, "ACKNOWLEDGE_EVERY", 0.0)


class Disk:
    """Disk whose writes and fsyncs fail or wait."""

    def __init__(self) -> None:
        self.write_error: OSError | None = None
        self.writes, self.syncs = threading.Event(), threading.Event()  # cleared: they hang
        self.writes.set()
        self.syncs.set()

    def reach(self, step: str) -> None:
        if step.startswith("fsync"):
            assert self.syncs.wait(PATIENCE)
        elif step.startswith(("open", "pwrite")):
            assert self.writes.wait(PATIENCE)
            if self.write_error:
                raise self.write_error


@pytest.fixture
def disk() -> Iterator[Disk]:
    disk = Disk()
    with observed(disk.reach):
        yield disk


async def send(box: Outbox, limit: int = 1000) -> list[str]:
    """Take the pending events, and acknowledge them."""
    found = list[str]()
    while limit > 0 and (entries := await box.next(min(limit, 100))):
        found += [Event.decode(entry.payload).identifier for entry in entries]
        box.acknowledge(entries)
        limit -= len(entries)
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


def stored(box: Outbox) -> bool:
    """Return True if all events of this run are durable."""
    return bool(inside(box, "_durable") == inside(box, "_newest"))


async def test_a_failing_disk_stops_no_event_and_gets_them_all_later_from_a_bounded_memory(
    tmp_path: Path, disk: Disk, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(outbox, "MEMORY_MAX", 3)
    caplog.set_level(logging.INFO, "slipflow")
    async with opened(Outbox(tmp_path / "outbox")) as box:
        for _ in range(4):
            await box.append([EVENT] * 2)
        await until(lambda: stored(box))
        disk.write_error = OSError(ENOSPC, "No space left on device")
        await box.append([EVENT] * 2)
        await box.append([EVENT])
        with pytest.raises(EndpointError, match="memory is full with 11 unsent events"):
            await box.append([EVENT])
        assert box.error.startswith("cannot be written: No space left on device; free")
        assert (box.unstored, len(await send(box, 10))) == (3, 10)
        assert (box.unstored, box.not_kept) == (1, 0)  # the others need no disk
        await box.append([EVENT])
        assert (box.unstored, box.not_kept) == (2, 1)
        disk.write_error = None
        await until(lambda: not box.error)
        assert (box.unstored, await send(box)) == (0, names(box.epoch, [11, 12]))
        epoch = box.epoch
    async with opened(Outbox(tmp_path / "outbox")) as box:
        assert await kept(box, epoch) == [*range(1, 9), *range(10, 13)]
    assert [record.levelname for record in caplog.records] == ["ERROR", "INFO", "ERROR"]
    assert caplog.messages[-1].endswith("outbox: 1 events that the broker has received are not kept")


async def test_a_hanging_disk_delays_no_event_for_long(
    tmp_path: Path, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outbox, "WRITE_TIMEOUT", 0.05)
    async with opened(Outbox(tmp_path / "outbox")) as box:
        disk.writes.clear()
        await box.append([EVENT])
        assert box.error == "the disk does not respond"
        assert await send(box) == names(box.epoch, [1])
        disk.writes.set()
        await until(lambda: not box.error)
        assert await kept(box, box.epoch) == [1]


async def test_events_do_not_wait_for_fsync(tmp_path: Path, disk: Disk) -> None:
    async with opened(Outbox(tmp_path / "outbox")) as box:
        await box.append([EVENT])  # creates a segment
        await until(lambda: stored(box))
        disk.syncs.clear()
        for _ in range(8):
            await box.append([EVENT])
        assert len(await send(box)) == 9
        assert not stored(box)
        disk.syncs.set()
        await until(lambda: stored(box))
        assert not box.error


async def test_damage_in_use_costs_one_event_and_at_the_start_the_rest_of_its_segment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(outbox, "MEMORY_MAX", 10)
    path = tmp_path / "outbox"
    async with opened(Outbox(path)) as box:
        epoch = box.epoch
        for _ in range(3):
            await box.append([EVENT] * 10)
        await until(lambda: stored(box))
        segment = inside(box, "_log", "_segments")[0]
        flip(segment.path, segment.offsets[6] + 50)
        assert await send(box) == names(epoch, [*range(1, 7), *range(8, 31)])
        assert await kept(box, epoch) == [*range(1, 7), *range(8, 31)]
    async with opened(Outbox(path)) as box:
        assert (await kept(box, epoch), box.waiting) == ([*range(1, 7), *range(11, 31)], 0)
    flip(segment.path, 10)  # its header
    for _ in range(2):
        async with opened(Outbox(path)) as box:
            assert await kept(box, epoch) == [*range(11, 31)]
    assert segment.path.with_suffix(".damaged").exists()
    assert caplog.messages == [
        f"{path}: event 7 of epoch {epoch} is damaged and lost",
        f"{segment.path}: damaged at byte {segment.offsets[6]}; the rest of it is lost",
        f"{segment.path}: damaged, and renamed to .damaged",
    ]


async def test_a_path_that_cannot_be_an_outbox_is_one_clear_error(tmp_path: Path) -> None:
    async def refusal(path: Path) -> str:
        with pytest.raises((EndpointError, InputError)) as caught:
            await Outbox(path).open()
        return str(caught.value)

    async with opened(Outbox(tmp_path / "outbox")):
        assert "two runs may not publish as one rig; name another rig" in await refusal(tmp_path / "outbox")
    (tmp_path / "file").write_text("x")
    assert "outbox: cannot be used: Not a directory" in await refusal(tmp_path / "file" / "outbox")
    assert "file: is a file, must be a folder: name another outbox" in await refusal(tmp_path / "file")
    (tmp_path / "other").mkdir()
    AppendLog(tmp_path / "other" / "1.log", b"precious").close()
    assert "is not part of an outbox" in await refusal(tmp_path / "other")


@pytest.mark.virtual
async def test_events_are_sent_from_memory_after_the_task_that_writes_them_has_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def fail(box: Outbox) -> None:
        await asyncio.sleep(0.5)
        raise KeyError("planted")

    monkeypatch.setattr(Outbox, "_keep_writing", fail)
    box = Outbox(tmp_path / "outbox")
    await box.open()
    await box.append([EVENT, EVENT])
    assert "the writing of events has failed: KeyError: 'planted'" in caplog.text
    assert len(await send(box)) == 2
    await box.append([EVENT])
    with pytest.raises(EndpointError, match="the writing of events has failed"):
        await box.close()
    assert "1 events are lost" in caplog.text
    assert asyncio.get_running_loop().time() < 5.0
