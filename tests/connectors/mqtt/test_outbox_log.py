from pathlib import Path

from connectors.mqtt.outbox_log import Entry, Epoch, OutboxLog
from connectors.mqtt.range_set import RangeSet


def _entry(number: int) -> Entry:
    return Entry(number, "epoch", number, "0", b"{}", 1.0)


def _fail_fsync(log: OutboxLog) -> None:
    newest = vars(log)["_log"]
    newest.suspect = True


def test_events_that_are_written_again_after_failed_fsyncs_are_the_newest_state(tmp_path: Path) -> None:
    log, epoch = OutboxLog(tmp_path / "outbox", keep=100, keep_for=1e9), Epoch("epoch", 0)
    log.open()
    log.epochs.append(epoch)
    log.append(epoch, [_entry(1), _entry(2)], RangeSet())
    epoch.last = 2
    _fail_fsync(log)
    log.append(epoch, [], RangeSet())  # a segment that begins after event 2
    _fail_fsync(log)
    log.append(epoch, [_entry(2), _entry(3)], RangeSet())
    log.close()
    again = OutboxLog(tmp_path / "outbox", keep=100, keep_for=1e9)
    again.open()
    assert again.last == 3
    assert [entry.id for entry in again.read([1, 2, 3])] == [1, 2, 3]
    again.close()


def test_events_that_are_deleted_need_not_be_sent_even_if_no_newer_one_is_stored(tmp_path: Path) -> None:
    log, epoch = OutboxLog(tmp_path / "outbox", keep=100, keep_for=10.0), Epoch("epoch", 0, last=2)
    log.open()
    log.epochs.append(epoch)
    log.append(epoch, [_entry(1), _entry(2)], RangeSet([(1, 2)]))
    log.append(epoch, [], RangeSet())  # a new segment, as the events are old
    log.prune(3)
    log.close()
    again = OutboxLog(tmp_path / "outbox", keep=100, keep_for=10.0)
    again.open()
    assert (again.first, again.last, [*again.settled]) == (0, 2, [(1, 2)])
    again.close()
