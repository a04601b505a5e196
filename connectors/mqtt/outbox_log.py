"""Numbered slip events in a folder of append-only logs; `connectors.mqtt.outbox.Outbox` calls it in threads.

Each run begins an epoch, which is a series of event numbers from 1. The logs of the folder are segments, in
the order of their names. Each holds events of one epoch with consecutive numbers, and acknowledgements of any
events. The records of a segment:

.. code-block:: text

    {"epoch": NAME, "first": NUMBER}                 first record: epoch, and number of the first event
    FINGERTIP NEWLINE PAYLOAD                        event
    {"acknowledged": [[EPOCH, NUMBER], ...]}         the broker has the events up to this one of an epoch
"""

import json
import logging
import os
from array import array
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from errno import EACCES
from pathlib import Path
from typing import Final

from operators.errors import EndpointError, InputError
from storage import files
from storage.append_log import AppendLog, LogReader
from storage.files import lock

log = logging.getLogger("slipflow")

IDENTITY: Final = b"slipflow outbox 2"
SEGMENT_EVENTS = 1000  # events of a segment
SEGMENTS = 100  # kept segments, besides those with unsent events


@dataclass(frozen=True, slots=True)
class Entry:
    """Numbered event."""

    epoch: str
    seq: int
    finger: str
    payload: bytes


@dataclass
class _Segment:
    """Segment file, and the offset of each of its events."""

    path: Path
    epoch: str
    first: int
    offsets: "array[int]" = field(default_factory=lambda: array("Q"))

    @property
    def last(self) -> int:
        return self.first + len(self.offsets) - 1


class OutboxLog:
    """Events and acknowledgements of one rig on disk, locked for one process.

    Attributes:
        epoch: Epoch of this run.
    """

    def __init__(self, path: Path, epoch: str) -> None:
        """Prepare to use the folder `path`."""
        self.path, self.epoch = path, epoch
        self._lock: int | None = None
        self._segments: list[_Segment] = []
        self._log: AppendLog | None = None  # the newest segment, if it is of this run

    @property
    def epochs(self) -> list[str]:
        """Epochs of which events may be stored, oldest first."""
        return list(dict.fromkeys(segment.epoch for segment in tuple(self._segments)))

    def span(self, epoch: str) -> tuple[int, int]:
        """Return the first and last stored number of an epoch; (1, 0) if there is none."""
        found = [each for each in tuple(self._segments) if each.epoch == epoch and each.offsets]
        return (min(each.first for each in found), max(each.last for each in found)) if found else (1, 0)

    def open(self) -> dict[str, int]:
        """Create or lock the folder and read it; return the newest sent number of each epoch, oldest first.

        Raises:
            EndpointError: if another process uses it.
            InputError: if the path is not an outbox.
            OSError: if it cannot be read or created.
        """
        if self.path.is_file():
            raise InputError(str(self.path), "is a file, must be a folder: name another outbox")
        files.make_folder(self.path, parents=True, mode=0o700)
        if not os.access(self.path, os.W_OK):
            raise PermissionError(EACCES, os.strerror(EACCES), str(self.path))
        self._lock = lock(self.path)
        if self._lock is None:
            reason = "is in use: two runs may not publish as one rig; name another rig or outbox"
            raise EndpointError(str(self.path), reason)
        sent = dict[str, int]()
        for path in sorted(self.path.glob("*.log")):
            self._read_segment(LogReader(path), sent)
        return {epoch: sent.get(epoch, 0) for epoch in self.epochs}

    def append(self, entries: Sequence[Entry], sent: Mapping[str, int]) -> None:
        """Append events with consecutive numbers, and the newest sent numbers of epochs: all, or OSError."""
        newest = self._segments[-1] if self._log and not self._log.suspect else None
        full = entries and newest and len(newest.offsets) >= SEGMENT_EVENTS
        if not newest or full or (entries and entries[0].seq != newest.last + 1):
            self._start_segment(entries[0].seq if entries else self.span(self.epoch)[1] + 1)
        assert self._log
        records = [b"%s\n%s" % (entry.finger.encode(), entry.payload) for entry in entries]
        if sent:
            records.append(json.dumps({"acknowledged": [*sent.items()]}).encode())
        offsets = self._log.append(records)
        self._segments[-1].offsets.extend(offsets[: len(entries)])

    def sync(self) -> None:
        """Make the appended records durable; raise OSError if they may be lost; the log is then `suspect`."""
        if newest := self._log:  # `append` may replace it in another thread
            newest.sync()

    def read(self, epoch: str, numbers: Sequence[int]) -> list[Entry]:
        """Return the events of an epoch with these numbers that are stored and intact, in any order."""
        found = dict[int, Entry]()
        for segment in reversed(tuple(self._segments)):  # the newest copy of an event is intact
            span = range(segment.first, segment.last + 1) if segment.epoch == epoch else ()
            wanted = [number for number in numbers if number in span and number not in found]
            if not wanted:
                continue
            with suppress(FileNotFoundError):  # may be pruned by now
                reader = LogReader(segment.path)
                for number in wanted:
                    if record := next(reader.records(segment.offsets[number - segment.first]), None):
                        finger, _, payload = record.data.partition(b"\n")
                        found[number] = Entry(epoch, number, finger.decode(), payload)
        return [*found.values()]

    def prune(self, sent: Mapping[str, int]) -> None:
        """Delete the oldest segments if there are too many, up to the first with an unsent event."""
        while len(self._segments) > SEGMENTS and self._segments[0].last <= sent[self._segments[0].epoch]:
            self._segments.pop(0).path.unlink(missing_ok=True)

    def close(self) -> None:
        """Close the files and unlock the folder."""
        if self._log:
            self._log.close()
        if self._lock is not None:
            os.close(self._lock)
        self._log = self._lock = None

    def _read_segment(self, reader: LogReader, sent: dict[str, int]) -> None:
        if reader.identity not in (IDENTITY, b""):
            reason = "is not part of an outbox: name another outbox, or move it away"
            raise InputError(str(reader.path), reason)
        records = reader.records()
        first = next(records, None)
        if first is None:
            reader.path.replace(reader.path.with_suffix(".damaged"))
            log.error("%s: damaged, and renamed to .damaged", reader.path)
            return
        acknowledgements = 0
        try:
            begin = json.loads(first.data)
            segment = _Segment(reader.path, str(begin["epoch"]), int(begin["first"]))
            for offset, data in records:
                if b"\n" in data:
                    segment.offsets.append(offset)
                    continue
                acknowledgements += 1
                for epoch, seq in json.loads(data)["acknowledged"]:
                    sent[epoch] = max(sent.get(epoch, 0), seq)
        except (ValueError, TypeError, LookupError) as error:
            reason = f"has an invalid record at byte {reader.end}: move it away"
            raise InputError(str(reader.path), reason) from error
        if reader.damage and not reader.damage.torn:
            log.error("%s: damaged at byte %d; the rest of it is lost", reader.path, reader.damage.offset)
        if segment.offsets or acknowledgements or reader.damage:
            self._segments.append(segment)
        else:  # of a run without events
            reader.path.unlink(missing_ok=True)

    def _start_segment(self, first: int) -> None:
        if self._log and not self._log.suspect:
            self._log.sync()
        number = int(self._segments[-1].path.stem) + 1 if self._segments else 1
        path = self.path / f"{number:020}.log"
        begin = json.dumps({"epoch": self.epoch, "first": first}).encode()
        created = AppendLog(path, IDENTITY, [begin])
        if self._log:
            self._log.close()
        self._log = created
        self._segments.append(_Segment(path, self.epoch, first))
