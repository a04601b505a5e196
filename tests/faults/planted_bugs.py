"""Bugs that are planted on purpose, to prove that the simulation finds such bugs."""

from collections import defaultdict
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from unittest.mock import patch

from connectors.mqtt import consumer, gap_replay, outbox, outbox_log, position
from connectors.mqtt.broker import Message
from storage import append_log, dataset, files, journal, writer
from tests.faults.schedule import LOST_PAGES

Plant = Callable[[ExitStack], object]


@dataclass(frozen=True)
class Bug:
    """A bug, and kinds of faults that reveal it."""

    plant: Plant
    kinds: tuple[str, ...]


def _set(owner: Any, name: str, value: Any) -> Plant:
    return lambda stack: stack.enter_context(patch.object(owner, name, value))


def _all(*plants: Plant) -> Plant:
    return lambda stack: [plant(stack) for plant in plants]


def _put_without_fsync(path: Path, data: bytes, *, durable: bool = True) -> None:
    _PUT(path, data, durable=False)
    files.sync(path.parent)


def _delete_journal_first(self: Any, **options: Any) -> None:
    if self.journal and self._committing:
        self.journal.rotate(self._single)
    _COMMIT_SELECTED(self, **options)


def _forget_failure(self: append_log.AppendLog) -> None:
    with suppress(OSError):
        _SYNC(self)
    self.suspect = False


def _prune_unsent(self: Any, sent: object) -> None:
    with patch.object(outbox_log, "SEGMENTS", 1):
        _PRUNE(self, defaultdict(lambda: 10**9))


def _save_before_processing(self: Any, topic: str, payload: bytes) -> Any:
    rig, event = _PROCESS(self, topic, payload)
    if event:
        self._change(self._position.take(event))
        self._save_position()
    return rig, event


async def _answer_missing(self: Any, now: float) -> list[Message]:
    messages = list[Message]()
    for request in self._pending:
        first, last = request.first, request.last
        answer = gap_replay.GapAnswer(request.epoch, first, last, ((first, last),))
        messages.append(Message(request.reply_to, answer.encode(), retain=False))
    self.clear()
    return messages


_PUT = files.put
_COMMIT_SELECTED = vars(writer.SessionWriter)["_commit_selected"]
_SYNC = append_log.AppendLog.sync
_PRUNE = outbox_log.OutboxLog.prune
_PROCESS = vars(consumer.Consumer)["_process"]

POWER = ("power loss",)
KILLS = ("kill rig", "kill rig at disk operation")

PLANTED: Final[dict[str, Bug]] = {
    "parts are not synced before they are listed": Bug(_set(files, "put", _put_without_fsync), POWER),
    "names are not synced": Bug(_set(files, "sync", lambda path: None), POWER),
    "the journal is deleted before its rows are in parts": Bug(
        _set(writer.SessionWriter, "_commit_selected", _delete_journal_first),
        ("disk full", "kill rig at disk operation"),
    ),
    "a failed fsync is ignored": Bug(_set(append_log.AppendLog, "sync", _forget_failure), LOST_PAGES),
    "the journal is synced every second": Bug(_set(dataset, "SYNC_INTERVAL", 1.0), POWER),
    "rows wait for the journal without limit": Bug(
        _all(
            _set(journal, "MAX_WAITING", 1000),
            _set(journal, "APPEND_AT", 1000),
            _set(dataset, "APPEND_AT", 1000),
            _set(dataset, "APPEND_INTERVAL", 1.0),
        ),
        KILLS,
    ),
    "unsent events are deleted": Bug(_set(outbox_log.OutboxLog, "prune", _prune_unsent), ("broker down",)),
    "a new run uses the numbers of the one before": Bug(
        _set(outbox, "token_hex", lambda size: "same" * size), ("kill rig", "power loss")
    ),
    "the consumer does not remove duplicates": Bug(
        _set(position.Position, "has", lambda self, event: False), ("connections cut",)
    ),
    "the consumer does not request missed events": Bug(
        _set(consumer.Consumer, "_request_missed", lambda self, link, rig: False),
        ("broker restart without memory",),
    ),
    "the consumer saves its position before an event is processed": Bug(
        _set(consumer.Consumer, "_process", _save_before_processing), ("kill consumer",)
    ),
    "gaps are answered as lost": Bug(
        _set(gap_replay.GapReplies, "next", _answer_missing), ("broker restart without memory",)
    ),
    "events fill the memory while the disk fails": Bug(
        _set(outbox.Outbox, "_make_room", lambda self, count: None), ("disk full", "disk error")
    ),
}
