"""Position of a consumer: received and missed slip events, in memory or in a file.

Only `lock_position` and `load` do I/O. Times are in s, of any clock that never goes back.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Annotated, Final, Literal, TypeAlias

import msgspec
from msgspec import Meta

from connectors.documents import INT64, Count, Document, Number, decode
from connectors.events import EPOCH_NAME_MAX, Event
from connectors.mqtt.gap_replay import GapAnswer
from operators.errors import EndpointError, InputError
from storage.files import lock_file, read, write_errors

RigId: TypeAlias = tuple[str, str]  # site and rig
Range: TypeAlias = tuple[int, int]  # first and last number

FORMAT: Final = 2
FILE_MAX = 32 * 2**20  # bytes; more than the longest names need
SIZE_MAX = 200_000  # numbers of all rigs; an epoch counts as `EPOCH_SIZE`
EPOCH_SIZE = 20
EPOCHS_MAX = 128  # per rig
AHEAD_MAX = 10_000  # events after a gap; beyond it, the gap is given up
REQUEST_EVERY = 3.0  # s, before a request is repeated; doubles with each that is not answered
REQUEST_LAST = 60.0  # s, longest time before a request is repeated
RETURN_WITHIN = 30.0  # s, for an epoch that the rig no longer announces; then its missed events are lost


class _Head(Document, frozen=True):
    epoch: Annotated[str, Meta(max_length=EPOCH_NAME_MAX)]
    last_seq: Count


class _Heads(_Head, frozen=True):
    before: Annotated[tuple[_Head, ...], Meta(max_length=EPOCHS_MAX - 1)] = ()


class _Epoch(msgspec.Struct):
    """Numbers of one epoch: all up to `done` are received or lost, and those in `ahead` are received."""

    site: str
    rig: str
    epoch: str
    done: Count = 0
    head: Annotated[int, Meta(ge=-1, le=INT64)] = -1  # newest announced number; -1: not announced yet
    ahead: set[Number] = set()
    delivered: bool = False  # an event of it was received

    def __post_init__(self) -> None:
        if self.ahead and min(self.ahead) <= self.done + 1:
            raise ValueError(f"`ahead` has {min(self.ahead)}, must be above {self.done + 1}")

    @property
    def gap(self) -> Range | None:
        """The first range of missed numbers."""
        last = min(self.ahead) - 1 if self.ahead else self.head
        return (self.done + 1, last) if last > self.done else None

    def has(self, number: int) -> bool:
        return number <= self.done or number in self.ahead

    def add(self, number: int) -> None:
        if not self.has(number):
            self.ahead.add(number)
            self._advance(self.done)

    def give_up(self, last: int) -> list[Range]:
        """Count the missed numbers up to `last` as lost, and return them."""
        lost = list[Range]()
        while (gap := self.gap) and gap[0] <= last:
            lost.append((gap[0], min(last, gap[1])))
            self._advance(lost[-1][1])
        return lost

    def _advance(self, done: int) -> None:
        while done + 1 in self.ahead:
            self.ahead.remove(done + 1)
            done += 1
        self.done = done


class _File(msgspec.Struct):
    format: Literal[2]
    rigs: list[_Epoch]


@dataclass
class _Rig:
    """Epochs of one rig, and the request that it may answer."""

    epochs: dict[str, _Epoch] = field(default_factory=dict[str, _Epoch])
    announced: frozenset[str] = frozenset()  # epochs of the newest head
    denied: dict[str, float] = field(default_factory=dict[str, float])  # time, by epoch, see `settle`
    request: tuple[str, int, int] = ("", 0, 0)  # epoch, first and last number
    asked: float = -inf  # time of the request
    wait: float = 0.0  # s after it until the next one

    @property
    def delivered(self) -> bool:
        return any(epoch.delivered for epoch in self.epochs.values())

    @property
    def size(self) -> int:
        return sum(EPOCH_SIZE + len(epoch.ahead) for epoch in self.epochs.values())


class Position:
    """Numbers of the received events, by rig and epoch, and requests for the missed ones.

    A new rig starts with its next event; with `everything`, with its first. Methods that return a list of
    texts report lost events. An event is lost if its rig answers that it no longer keeps it. If the rig does
    not announce its epoch either, it counts as lost only after 30 s: another rig of the same name, which
    uses the broker in turn with the right one, answers the same.

    Memory is bounded: what never delivered an event is forgotten first, then the rig silent for longest.

    >>> position = Position()
    >>> position.announce(("lab", "ur10"), {"ab": 4})
    []
    >>> position.announce(("lab", "ur10"), {"ab": 6}), position.request(("lab", "ur10"), 0.0)
    ([], ('ab', 5, 6))
    >>> position.settle(("lab", "ur10"), GapAnswer("ab", 5, 6, ((5, 5),)), 0.1)
    ['lab/ur10: event 5 of epoch ab is lost: no longer kept']
    """

    def __init__(self, *, everything: bool = False) -> None:
        """Start empty; with `everything`, events before the first contact with a rig count as missed."""
        self._everything = everything
        self._rigs: dict[RigId, _Rig] = {}  # the one silent for longest first

    @property
    def rigs(self) -> list[RigId]:
        """Known rigs."""
        return list(self._rigs)

    def has(self, event: Event) -> bool:
        """Return True if an event was received or counts as lost."""
        rig = self._rigs.get((event.site, event.rig))
        return rig is not None and event.epoch in rig.epochs and rig.epochs[event.epoch].has(event.seq)

    def take(self, event: Event) -> list[str]:
        """Mark an event as received; give up the oldest gap if too many events have come since."""
        name = event.site, event.rig
        known = self._rigs.pop(name, None)
        rig = self._rigs[name] = known or _Rig()
        start = 0 if known or self._everything else event.seq - 1
        epoch = rig.epochs.setdefault(event.epoch, _Epoch(*name, event.epoch, start))
        epoch.add(event.seq)
        epoch.delivered = True
        rig.denied.pop(event.epoch, None)
        rig.wait = min(rig.wait, REQUEST_EVERY)
        lost = epoch.give_up(min(epoch.ahead) - 1) if len(epoch.ahead) > AHEAD_MAX else []
        why = "given up after too many gaps without an answer"
        return [*_lost(name, event.epoch, lost, why), *self._forget(rig)]

    def announce(self, name: RigId, heads: dict[str, int]) -> list[str]:
        """Raise the newest number of each epoch that a rig keeps."""
        rig = self._rigs.setdefault(name, _Rig())
        first = all(each.head < 0 for each in rig.epochs.values())
        rig.announced = frozenset(heads)
        for each, head in heads.items():
            if each not in rig.epochs:
                rig.epochs[each] = _Epoch(*name, each, head if first and not self._everything else 0)
            rig.epochs[each].head = max(rig.epochs[each].head, head)
            rig.denied.pop(each, None)
        if rig.delivered:
            rig.wait = min(rig.wait, REQUEST_EVERY)
        return self._forget(rig)

    def request(self, name: RigId, now: float) -> tuple[str, int, int] | None:
        """Return the events to request from a rig now: epoch, first and last number; None if there are none.

        A rig may answer for 3 s, and twice as long after each request that it has not answered. Then it is
        asked about another epoch, if events of one are missed.
        """
        rig = self._rigs.get(name)
        if rig is None or now < rig.asked + rig.wait:
            return None
        gaps = [(each, *gap) for each, epoch in rig.epochs.items() if (gap := epoch.gap)]
        if not gaps:
            return None
        rig.request = next((gap for gap in gaps if gap[0] != rig.request[0]), gaps[0])
        rig.asked, rig.wait = now, min(max(2 * rig.wait, REQUEST_EVERY), REQUEST_LAST)
        return rig.request

    def reconnected(self) -> None:
        """Allow each rig one request at once; answers to earlier ones will not come."""
        for rig in self._rigs.values():
            rig.request, rig.asked = ("", 0, 0), -inf

    def settle(self, name: RigId, answer: GapAnswer, now: float) -> list[str]:
        """Close the gaps that an answer to the latest request lists as missing, and report their events."""
        rig = self._rigs.get(name)
        if rig is None or rig.request[:2] != (answer.epoch, answer.first) or answer.epoch not in rig.epochs:
            return []
        epoch = rig.epochs[answer.epoch]
        requested, rig.request = rig.request[1:], ("", 0, 0)
        if answer.missing and answer.epoch not in rig.announced:
            rig.request = (answer.epoch, 0, 0)  # the next request is about another epoch, if there is one
            if now < rig.denied.setdefault(answer.epoch, now) + RETURN_WITHIN:
                return []
        lost = list[Range]()
        for first, last in answer.missing:
            if first <= epoch.done + 1:  # else an event of the answer did not arrive: request again
                lost += epoch.give_up(last)
        if epoch.gap != requested:  # else the answer was of no use
            rig.wait = 0.0
        return [*_lost(name, answer.epoch, lost, "no longer kept")]

    def encode(self) -> bytes:
        """Return the position as JSON."""
        epochs = [epoch for rig in self._rigs.values() for epoch in rig.epochs.values()]
        return msgspec.json.encode(_File(FORMAT, epochs), order="deterministic")

    @classmethod
    def decode(cls, payload: bytes, where: str, *, everything: bool = False) -> "Position":
        """Parse the output of `encode`; an InputError names `where` and the field."""
        position = cls(everything=everything)
        for epoch in decode(payload, _File, where, largest=FILE_MAX).rigs:
            position._rigs.setdefault((epoch.site, epoch.rig), _Rig()).epochs[epoch.epoch] = epoch
        for rig in list(position._rigs.values()):
            rig.announced = frozenset(name for name, epoch in rig.epochs.items() if epoch.head >= 0)
            position._forget(rig)
        return position

    def _forget(self, rig: _Rig) -> list[str]:
        """Forget epochs of a rig, and rigs, if there are too many; report the rigs that have delivered."""
        if len(rig.epochs) > EPOCHS_MAX:  # one that is announced again would be fetched from its first event
            worth = sorted(rig.epochs, key=lambda each: (rig.epochs[each].delivered, each in rig.announced))
            for each in worth[:-EPOCHS_MAX]:
                del rig.epochs[each]
        size, forgotten = sum(each.size for each in self._rigs.values()), list[str]()
        while size > SIZE_MAX:
            unheard = (each for each, known in self._rigs.items() if not known.delivered)
            name = next(unheard, next(iter(self._rigs)))
            gone = self._rigs.pop(name)
            size -= gone.size
            if gone.delivered:
                forgotten.append(f"{'/'.join(name)}: position forgotten: too many rigs and epochs")
        return forgotten


def read_heads(payload: bytes, where: str) -> dict[str, int]:
    """Read the newest number of each epoch from a rig's ``head`` document.

    >>> read_heads(b'{"epoch":"b","last_seq":2,"before":[{"epoch":"a","last_seq":9}]}', "head")
    {'a': 9, 'b': 2}
    """
    newest = decode(payload, _Heads, where)
    return {each.epoch: each.last_seq for each in (*newest.before, newest)}


def lock_position(path: Path) -> int:
    """Lock a position file for this process; return the descriptor that holds the lock until it is closed.

    Raises:
        EndpointError: if another consumer holds the lock, or the folder cannot be written.
    """
    with write_errors(path):
        held = lock_file(path)
    if held is None:
        raise EndpointError(str(path), "is in use by another consumer; name another file")
    return held


def load(path: Path, *, everything: bool = False) -> Position:
    """Read a position from a file; return an empty position if the file does not exist.

    Raises:
        InputError: if the file cannot be read, is damaged, or is not a position.
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
