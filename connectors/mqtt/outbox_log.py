"""Numbered slip events in a folder of append-only logs; `connectors.mqtt.outbox.Outbox` calls it in threads.

Each record of a segment is a line of JSON, followed by the payload if it is an event:

.. code-block:: text

    {"epoch": {"name", "base", "last"}, "ended": BOOL}            epoch of the events that follow
    [ID, FINGERTIP, TIME]                                         event, time of its creation in s
    {"acknowledged": [[FIRST, LAST], ...]}                        ids that the broker has received

The ids of events count through all epochs; the number of an event is its id minus the base of its epoch. An
epoch is complete if its end is the last record of the folder.
"""

import json
import logging
import os
import time
from array import array
from bisect import bisect_left
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

from connectors.mqtt.range_set import RangeSet
from operators.errors import EndpointError, InputError
from storage import files
from storage.append_log import AppendLog, LogReader
from storage.lock import lock

log = logging.getLogger("slipflow")

IDENTITY: Final = b"slipflow outbox 1"
SEGMENT_EVENTS = 1000  # events of a segment; older segments are deleted as a whole
SEGMENT_SPAN = 86400.0  # s, from the first to the last event of a segment


@dataclass
class Epoch:
    """Series of event numbers."""

    name: str
    base: int  # id before that of number 1
    last: int = 0  # newest number


@dataclass(frozen=True, slots=True)
class Entry:
    """Numbered event."""

    id: int
    epoch: str
    seq: int
    finger: str
    payload: bytes
    time: float  # s since 1970, of its creation


@dataclass
class _Segment:
    """Segment file, and the id and offset of each of its events."""

    path: Path
    ids: "array[int]" = field(default_factory=lambda: array("Q"))
    offsets: "array[int]" = field(default_factory=lambda: array("Q"))
    started: float = 0.0  # s since 1970, time of the first event
    time: float = 0.0  # s since 1970, time of the newest event

    def add(self, number: int, offset: int, created: float) -> None:
        at = bisect_left(self.ids, number)
        if at < len(self.ids) and self.ids[at] == number:  # written again after a failed fsync
            self.offsets[at] = offset
        else:
            self.ids.insert(at, number)
            self.offsets.insert(at, offset)
        self.started, self.time = self.started or created, created

    def offset(self, number: int) -> int | None:
        at = bisect_left(self.ids, number)
        return self.offsets[at] if at < len(self.ids) and self.ids[at] == number else None


class OutboxLog:
    """Events, acknowledgements and epochs of one rig on disk, locked for one process.

    Attributes:
        epochs: All epochs of which events are stored, oldest first; as of `open`.
        complete: True if the newest epoch ended in order, so that it may continue; as of `open`.
        settled: Ids that need not be sent: acknowledged or not readable; as of `open`.
    """

    def __init__(self, path: Path, *, keep: int, keep_for: float) -> None:
        """Prepare to use the folder `path`, which keeps `keep` sent events for `keep_for` s."""
        self.path, self._keep, self._keep_for = path, keep, keep_for
        self.epochs: list[Epoch] = []
        self.complete, self.settled = False, RangeSet()
        self._lock: int | None = None
        self._segments: list[_Segment] = []
        self._log: AppendLog | None = None  # the newest segment
        self._epoch = ""  # name in the newest epoch record

    @property
    def first(self) -> int:
        """Id of the oldest stored event; 0 if there is none."""
        return next((segment.ids[0] for segment in self._segments if segment.ids), 0)

    @property
    def last(self) -> int:
        """Newest id that is stored or was used."""
        return max([0, *(epoch.base + epoch.last for epoch in self.epochs)])

    @property
    def suspect(self) -> bool:
        """True if an fsync failed: events since the last one must be appended again."""
        return self._log is not None and self._log.suspect

    def open(self) -> None:
        """Create or lock the folder, and read it.

        Raises:
            EndpointError: if another process uses it.
            InputError: if the path is not an outbox.
            OSError: if it cannot be read or created.
        """
        self._lock_folder()
        paths = sorted(self.path.glob("*.log"))
        for path in paths:
            with LogReader(path) as reader:
                self._read_segment(reader)
                if path == paths[-1] and reader.identity and not (reader.damage and reader.damage.more):
                    self._log = AppendLog.resume(reader)
        stored = RangeSet((number, number) for segment in self._segments for number in segment.ids)
        oldest = self.first or self.last + 1
        self.settled.add(1, oldest - 1)
        for first, last in stored.gaps(oldest, self.last):
            self.settled.add(first, last)
            log.error("%s: %d events cannot be read and are lost", self.path, last - first + 1)
        self.epochs = [each for each in self.epochs if self._is_stored(each)]
        self._epoch = ""  # the next record marks the epoch as in use

    def append(
        self, epoch: Epoch, entries: Sequence[Entry], acknowledged: RangeSet, *, ended: bool = False
    ) -> None:
        """Append events and acknowledgements, all or none, in a new segment if the newest is full.

        Args:
            epoch: Epoch of the events.
            entries: Events.
            acknowledged: Ids that the broker has received.
            ended: The epoch ends in order.

        Raises:
            EndpointError: if another process uses the folder.
            OSError: if nothing was stored.
        """
        if self._lock is None:
            self._lock_folder()
        if self._log is None or self.suspect or self._log.broken or self._is_full(self._segments[-1]):
            self._start_segment(epoch, entries[0].id if entries else epoch.base + epoch.last + 1)
        assert self._log
        begin = [] if epoch.name == self._epoch else [_encode_epoch(epoch)]
        events = [_encode_event(entry) for entry in entries]
        rest = [json.dumps({"acknowledged": [*acknowledged]}).encode()] if len(acknowledged) else []
        end = [_encode_epoch(epoch, ended=True)] if ended else []
        offsets = self._log.append([*begin, *events, *rest, *end])
        self._epoch = epoch.name
        for entry, offset in zip(entries, offsets[len(begin) :], strict=False):
            self._segments[-1].add(entry.id, offset, entry.time)

    def sync(self) -> None:
        """Make the appended records durable.

        Raises:
            OSError: if they may be lost; the log is then `suspect`.
        """
        if newest := self._log:  # `append` may replace it in another thread
            newest.sync()

    def read(self, ids: Sequence[int]) -> list[Entry]:
        """Return the events with these ids that are stored and intact.

        Raises:
            OSError: if a segment cannot be read.
        """
        found = dict[int, Entry]()
        for segment in tuple(self._segments):  # another thread may append or prune
            wanted = [(number, offset) for number in ids if (offset := segment.offset(number)) is not None]
            if not wanted:
                continue
            with suppress(FileNotFoundError), LogReader(segment.path) as reader:  # may be pruned by now
                for _, offset in wanted:
                    if record := next(reader.records(offset), None):
                        entry = self._decode(record.data)
                        found[entry.id] = entry
        return [found[number] for number in ids if number in found]

    def prune(self, pending: int) -> None:
        """Delete segments that are too old or too many; all ids before `pending` are settled.

        Raises:
            OSError: if a file cannot be deleted.
        """
        kept = sum(len(segment.ids) for segment in self._segments)
        while len(self._segments) > 1:
            oldest = self._segments[0]
            kept -= len(oldest.ids)
            expired = kept >= self._keep or oldest.time < time.time() - self._keep_for
            if not expired or (oldest.ids and oldest.ids[-1] >= pending):
                return
            del self._segments[0]
            files.unlink(oldest.path)

    def close(self) -> None:
        """Close the files and unlock the folder."""
        self._close_log()
        if self._lock is not None:
            os.close(self._lock)
        self._lock = None

    def _lock_folder(self) -> None:
        if self.path.is_file():
            raise InputError(str(self.path), "is a file, must be a folder: name another outbox")
        files.make_folder(self.path, parents=True, mode=0o700)
        self._lock = lock(self.path)
        if self._lock is None:
            reason = "is in use: two runs may not publish as one rig; name another rig or outbox"
            raise EndpointError(str(self.path), reason)

    def _read_segment(self, reader: LogReader) -> None:
        if reader.identity not in (IDENTITY, b""):
            raise InputError(
                str(reader.path), "is not part of an outbox: name another outbox, or move it away"
            )
        if not reader.identity:
            files.rename(reader.path, reader.path.with_suffix(".damaged"))
            log.error("%s: damaged, and renamed to .damaged", reader.path)
            self.complete = False  # the lost records may have used numbers
            return
        segment = _Segment(reader.path)
        self._segments.append(segment)
        try:
            for offset, data in reader.records():
                self._read_record(segment, offset, data)
        except (ValueError, TypeError, LookupError) as error:
            reason = f"has an invalid record at byte {reader.end}: move it away"
            raise InputError(str(reader.path), reason) from error
        if reader.damage:
            self.complete = False
        if reader.damage and reader.damage.more:
            log.error("%s: damaged at byte %d; the rest of it is lost", reader.path, reader.damage.offset)

    def _read_record(self, segment: _Segment, offset: int, data: bytes) -> None:
        content: Any = json.loads(data.partition(b"\n")[0])
        self.complete = False
        if data.startswith(b"["):
            number, _, created = content
            segment.add(number, offset, created)
            self.epochs[-1].last = max(self.epochs[-1].last, number - self.epochs[-1].base)
        elif "acknowledged" in content:
            for first, last in content["acknowledged"]:
                self.settled.add(first, last)
        else:
            name, base, last = (content["epoch"][key] for key in ("name", "base", "last"))
            epoch, self.complete = Epoch(name, base, last), content["ended"]
            if self.epochs and self.epochs[-1].name == epoch.name:
                del self.epochs[-1]
            self.epochs.append(epoch)
            self._epoch = epoch.name

    def _is_stored(self, epoch: Epoch) -> bool:
        return epoch is self.epochs[-1] or epoch.base + epoch.last >= self.first > 0

    def _is_full(self, segment: _Segment) -> bool:
        full = len(segment.ids) >= SEGMENT_EVENTS
        return full or 0 < segment.started < time.time() - SEGMENT_SPAN

    def _start_segment(self, epoch: Epoch, first: int) -> None:
        """Create a segment that begins with id `first`; replace one whose events are all written again."""
        if self._log and not self._log.suspect:
            self._log.sync()
        path = self.path / f"{self._next_number(first):020}.log"
        created = AppendLog.create(path, IDENTITY, [_encode_epoch(epoch)])
        self._close_log()
        self._log, self._epoch = created, epoch.name
        self._segments = [*(each for each in self._segments if each.path != path), _Segment(path)]

    def _next_number(self, first: int) -> int:
        """Return the number of the next segment, which must be read after the newest one."""
        if not self._segments:
            return first
        newest = self._segments[-1]
        number = int(newest.path.stem)
        if first > number:
            return first
        return number + (len(newest.ids) > 0 and newest.ids[0] < first)

    def _decode(self, data: bytes) -> Entry:
        head, _, payload = data.partition(b"\n")
        number, finger, created = json.loads(head)
        epoch = next(each for each in reversed(self.epochs) if each.base < number)
        return Entry(number, epoch.name, number - epoch.base, finger, payload, created)

    def _close_log(self) -> None:
        if self._log:
            self._log.close()
        self._log = None


def _encode_event(entry: Entry) -> bytes:
    return json.dumps([entry.id, entry.finger, entry.time]).encode() + b"\n" + entry.payload


def _encode_epoch(epoch: Epoch, *, ended: bool = False) -> bytes:
    return json.dumps({"epoch": asdict(epoch), "ended": ended}).encode()
