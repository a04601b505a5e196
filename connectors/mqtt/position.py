"""Position of a consumer: received and missed slip events, in memory or in a file.

Only `lock_position` and `load` do I/O.
"""

from bisect import bisect_left
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

from connectors.events import Event, encode
from connectors.fields import Fields
from connectors.mqtt.gap_replay import GapAnswer
from operators.errors import EndpointError, InputError, os_error_reason
from operators.ports import Json
from storage.files import read
from storage.lock import lock_file

RigId: TypeAlias = tuple[str, str]  # site and rig
Range: TypeAlias = tuple[int, int]  # first and last number

FORMAT = 2
FILE_MAX = 32 * 2**20  # bytes
SIZE_MAX = 1_000_000  # numbers; beyond it, the rig without an event for the longest time is forgotten
EPOCH_SIZE = 20  # numbers that an epoch counts as, besides one per character of its name
EPOCHS_MAX = 128  # per rig; beyond it, the first is dropped
AHEAD_MAX = 10_000  # events after a gap; beyond it, the gap is given up


@dataclass
class _Epoch:
    """Numbers of one epoch: all up to `done` are received or lost, and those in `ahead` are received."""

    done: int = 0
    ahead: list[int] = field(default_factory=list[int])  # sorted
    head: int = -1  # newest number announced by the rig; -1: the rig has not announced the epoch yet

    @property
    def newest(self) -> int:
        return max(self.done, self.head, *self.ahead[-1:])

    @property
    def gap(self) -> Range | None:
        """The first range of missed numbers."""
        last = self.ahead[0] - 1 if self.ahead else self.newest
        return (self.done + 1, last) if last > self.done else None

    def has(self, number: int) -> bool:
        at = bisect_left(self.ahead, number)
        return number <= self.done or self.ahead[at : at + 1] == [number]

    def add(self, number: int) -> None:
        if not self.has(number):
            self.ahead.insert(bisect_left(self.ahead, number), number)
            self._advance()

    def give_up(self, last: int) -> list[Range]:
        """Count the missed numbers up to `last` as lost, and return them."""
        lost = list[Range]()
        while self.done < last:
            end = min([last, *(number - 1 for number in self.ahead[:1])])
            lost.append((self.done + 1, end))
            self.done = end
            self._advance()
        return lost

    def _advance(self) -> None:
        count = 0
        while count < len(self.ahead) and self.ahead[count] == self.done + 1:
            self.done, count = self.done + 1, count + 1
        del self.ahead[:count]


class Position:
    """Numbers of the received events, by rig and epoch.

    A new rig starts with its next event; with `everything`, with its first. Methods that return a list of
    texts report lost events.

    >>> position = Position()
    >>> position.announce(("lab", "ur10"), {"ab": 4})
    []
    >>> position.announce(("lab", "ur10"), {"ab": 6}), position.gap(("lab", "ur10"))
    ([], ('ab', 5, 6))
    >>> position.settle(("lab", "ur10"), GapAnswer("ab", 5, 6, ((5, 5),)))
    ['lab/ur10: event 5 of epoch ab is lost: no longer kept']
    """

    def __init__(self, *, everything: bool = False) -> None:
        """Start empty; with `everything`, events before the first contact with a rig count as missed."""
        self._everything = everything
        self._rigs: dict[RigId, dict[str, _Epoch]] = {}

    def has(self, event: Event) -> bool:
        """Return True if an event was received or counts as lost."""
        epoch = self._rigs.get((event.site, event.rig), {}).get(event.epoch)
        return epoch is not None and epoch.has(event.seq)

    def take(self, event: Event) -> list[str]:
        """Mark an event as received; give up the oldest gap if too many events have come since."""
        rig = event.site, event.rig
        epochs = self._rigs.pop(rig, None)
        if epochs is None:
            epochs = {event.epoch: _Epoch(0 if self._everything else event.seq - 1)}
        self._rigs[rig] = epochs  # the last to be forgotten
        epoch = epochs.setdefault(event.epoch, _Epoch())
        epoch.add(event.seq)
        excess = epoch.ahead[0] - 1 if len(epoch.ahead) > AHEAD_MAX else 0
        lost = _lost(
            rig, event.epoch, epoch.give_up(excess), "given up after too many gaps without an answer"
        )
        return [*lost, *(self._limit(epochs) if epoch.ahead or epoch.head < 0 else ())]

    def announce(self, rig: RigId, heads: dict[str, int]) -> list[str]:
        """Set the newest number of each epoch that a rig keeps, the current epoch last.

        A head whose current epoch is known, but not the newest, is older than the one before, and is ignored
        unless its number is new. The gaps of epochs that are no longer kept are closed and reported as lost;
        the epochs stay known, so that an older head does not bring them back.
        """
        epochs = self._rigs.setdefault(rig, {})
        newest = next((name for name in reversed(epochs) if epochs[name].head >= 0), None)
        current, last = list(heads.items())[-1]
        if current != newest and current in epochs and last <= epochs[current].head:
            return []
        count = len(epochs)
        for name, head in heads.items():
            epoch = epochs.pop(name, None)  # the order of the epochs becomes that of the head
            if epoch is None:
                epoch = _Epoch(head if newest is None and not self._everything else 0)
            epoch.head = max(epoch.head, head)
            epochs[name] = epoch
        lost = list[str]()
        for name, epoch in epochs.items():
            if name in heads or epoch.head < 0:
                continue
            end = epoch.newest
            lost += _lost(rig, name, epoch.give_up(end), "no longer kept")
            if name == newest and end:  # its last number was never announced
                lost.append(
                    f"{'/'.join(rig)}: epoch {name} is no longer kept; events after {end} may be lost"
                )
        return lost + (self._limit(epochs) if len(epochs) > count else [])

    def settle(self, rig: RigId, answer: GapAnswer) -> list[str]:
        """Close the gaps that an answer lists as missing, and report their events as lost."""
        epoch = self._rigs.get(rig, {}).get(answer.epoch)
        lost = list[Range]()
        for first, last in answer.missing if epoch else ():
            if epoch and first <= epoch.done + 1:  # else an event of the answer did not arrive: request again
                lost += epoch.give_up(min(last, epoch.newest))
        return [*_lost(rig, answer.epoch, lost, "no longer kept")]

    def gap(self, rig: RigId) -> tuple[str, int, int] | None:
        """Return the first missed range of a rig: epoch, first and last number."""
        for name, epoch in self._rigs.get(rig, {}).items():
            if gap := epoch.gap:
                return name, *gap
        return None

    def rigs(self) -> list[RigId]:
        """Return the known rigs."""
        return list(self._rigs)

    def encode(self) -> bytes:
        """Return the position as JSON."""
        rigs: list[Json] = [
            {
                "site": site,
                "rig": rig,
                "epoch": name,
                "done": each.done,
                "head": each.head,
                "ahead": each.ahead,
            }
            for (site, rig), epochs in self._rigs.items()
            for name, each in epochs.items()
        ]
        return encode({"format": FORMAT, "rigs": rigs})

    @classmethod
    def decode(cls, payload: bytes, where: str, *, everything: bool = False) -> "Position":
        """Parse the output of `encode`.

        Raises:
            InputError: naming `where` and the field that is missing or wrong.
        """
        position, fields = cls(everything=everything), Fields.parse(payload, where, largest=FILE_MAX)
        fields.integer("format", FORMAT, FORMAT)
        for rig in fields.objects("rigs"):
            name = rig.text("site"), rig.text("rig")
            epoch = _Epoch(rig.integer("done", 0), head=rig.integer("head", -1))
            for number in rig.integers("ahead"):
                epoch.add(number)
            position._rigs.setdefault(name, {})[rig.text("epoch")] = epoch
        return position

    def _limit(self, epochs: dict[str, _Epoch]) -> list[str]:
        """Drop the first epochs of a rig, and forget the first rigs, if there are too many numbers."""
        while len(epochs) > EPOCHS_MAX:
            del epochs[next(iter(epochs))]
        forgotten, size = list[str](), sum(map(_size, self._rigs.values()))
        while size > SIZE_MAX:
            site, rig = next(iter(self._rigs))
            size -= _size(self._rigs.pop((site, rig)))
            forgotten.append(f"{site}/{rig}: position forgotten, because there are too many rigs and epochs")
        return forgotten


def _size(epochs: dict[str, _Epoch]) -> int:
    return sum(EPOCH_SIZE + len(name) + len(epoch.ahead) for name, epoch in epochs.items())


def read_heads(fields: Fields) -> dict[str, int]:
    """Read the newest number of each epoch from a rig's ``head`` document.

    >>> read_heads(Fields.parse(b'{"epoch":"b","last_seq":2,"before":[{"epoch":"a","last_seq":9}]}', "head"))
    {'a': 9, 'b': 2}

    Raises:
        InputError: naming the field that is missing or wrong.
    """
    before = fields.objects("before") if "before" in fields.values else []
    if len(before) >= EPOCHS_MAX:
        fields.fail("before", f"a list of fewer than {EPOCHS_MAX}")
    return {each.text("epoch"): each.integer("last_seq", 0) for each in (*before, fields)}


def lock_position(path: Path) -> int:
    """Lock a position file for this process; return the descriptor that holds the lock until it is closed.

    Raises:
        EndpointError: if another consumer holds the lock, or the folder cannot be written.
    """
    try:
        held = lock_file(path)
    except OSError as error:
        raise EndpointError(str(path), f"cannot be written: {os_error_reason(error)}") from None
    if held is None:
        raise EndpointError(str(path), "is in use by another consumer; name another file")
    return held


def load(path: Path, *, everything: bool = False) -> Position:
    """Read a position from a file; return an empty position if the file does not exist.

    Raises:
        InputError: if the file cannot be read, is damaged, or is not a position.
        EndpointError: if the disk fails, or memory or file descriptors are short.
    """
    if not path.exists():
        return Position(everything=everything)
    payload = read(path, FILE_MAX)
    try:
        return Position.decode(payload, str(path), everything=everything)
    except InputError as error:
        hint = "is not a position file; name another file, or delete it to start over"
        raise InputError(str(path), f"{error.reason}: {hint}") from None


def _lost(rig: RigId, epoch: str, ranges: Iterable[Range], why: str) -> Iterator[str]:
    """Yield the reports of lost events."""
    for first, last in ranges:
        which, verb = (f"event {first}", "is") if first == last else (f"events {first} to {last}", "are")
        yield f"{'/'.join(rig)}: {which} of epoch {epoch} {verb} lost: {why}"
