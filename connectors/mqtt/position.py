"""Position of a consumer: received and missed slip events, in memory or in a file.

Only `lock_position` and `load` do I/O.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

from connectors.events import Event, encode
from connectors.fields import Fields
from connectors.mqtt.gap_replay import GapAnswer
from connectors.mqtt.range_set import RangeSet
from operators.errors import EndpointError, InputError, os_error_reason
from operators.ports import Json
from storage.files import read
from storage.lock import lock_file

RigId: TypeAlias = tuple[str, str]  # site and rig

FORMAT = 1
FILE_MAX = 16 * 2**20  # bytes
RIGS_MAX = 1000  # beyond it, the rig that was added first is forgotten
EPOCHS_MAX = 128  # per rig; beyond it, the first is dropped
GAPS_MAX = 1000  # per epoch; beyond it, the first gap is given up


@dataclass
class _Epoch:
    """Numbers of one epoch."""

    seen: RangeSet = field(default_factory=RangeSet)
    head: int = -1  # the newest number announced by the rig; -1: the rig has not announced the epoch yet

    @property
    def announced(self) -> bool:
        return self.head >= 0

    def gaps(self) -> Iterator[tuple[int, int]]:
        return self.seen.gaps(1, max(self.head, self.seen.highest))


class Position:
    """Numbers of the received events, by rig and epoch.

    A new rig starts with its next event; with `everything`, with its first. Methods that return a list of
    texts report lost events.

    >>> position = Position()
    >>> position.announce(("lab", "ur10"), {"ab": 4})
    []
    >>> position.announce(("lab", "ur10"), {"ab": 6}), list(position.gaps())
    ([], [(('lab', 'ur10'), 'ab', 5, 6)])
    >>> position.settle(("lab", "ur10"), GapAnswer("ab", 5, 6, ((5, 5),)))
    ['lab/ur10: event 5 of epoch ab is lost: no longer kept']
    """

    def __init__(self, *, everything: bool = False) -> None:
        """Start empty; with `everything`, events before the first contact with a rig count as missed."""
        self._everything = everything
        self._rigs: dict[RigId, dict[str, _Epoch]] = {}

    def take(self, event: Event) -> bool:
        """Mark an event as received; return False if it already was."""
        rig, epochs = (event.site, event.rig), self._rigs.get((event.site, event.rig))
        if epochs is None:
            epochs = self._rigs[rig] = {}
            if not self._everything:
                epochs.setdefault(event.epoch, _Epoch()).seen.add(1, event.seq - 1)
        epoch = self._epoch(epochs, event.epoch)
        if event.seq in epoch.seen:
            return False
        epoch.seen.add(event.seq)
        return True

    def announce(self, rig: RigId, heads: dict[str, int]) -> list[str]:
        """Set the newest number of each epoch that a rig keeps, the current epoch last.

        A head that is older than the previous one is ignored: it has a lower number of a known epoch, or the
        known number of an earlier epoch. The gaps of epochs that are no longer kept are closed and reported
        as lost; the epochs stay known, so that an older head does not bring them back.
        """
        epochs = self._rigs.setdefault(rig, {})
        newest = next((name for name in reversed(epochs) if epochs[name].announced), None)
        current, last = list(heads.items())[-1]
        known = epochs[current].head if current in epochs else -1
        if known >= 0 and (last < known or (current != newest and last == known)):
            return []
        for name, head in heads.items():
            epoch = epochs.pop(name, None)  # the order of the epochs becomes that of the head
            if epoch is None:
                epoch = _Epoch()
                epoch.seen.add(1, head if newest is None and not self._everything else 0)
            epoch.head = max(epoch.head, head)
            epochs[name] = epoch
        lost = list[str]()
        for name, epoch in epochs.items():
            if name in heads or not epoch.announced:
                continue
            missed = [f"{first} to {last}" if first < last else str(first) for first, last in epoch.gaps()]
            end = max(epoch.head, epoch.seen.highest)
            epoch.seen.add(1, end)
            if name == newest:  # its last number was never announced
                missed.append(f"any after {end}")
            if missed:
                which = ", ".join(missed)
                lost.append(f"{'/'.join(rig)}: epoch {name} is no longer kept; lost events: {which}")
        while len(epochs) > EPOCHS_MAX:
            del epochs[next(iter(epochs))]
        return lost

    def settle(self, rig: RigId, answer: GapAnswer) -> list[str]:
        """Close the gaps that an answer lists as missing, and report their events as lost."""
        epoch = self._rigs.get(rig, {}).get(answer.epoch)
        if epoch is None:
            return []
        missing = [gap for low, high in answer.missing for gap in epoch.seen.gaps(low, high)]
        for gap in missing:
            epoch.seen.add(*gap)
        return [_lost(rig, answer.epoch, *gap, "no longer kept") for gap in missing]

    def gaps(self) -> Iterator[tuple[RigId, str, int, int]]:
        """Yield the first gap of each epoch: rig, epoch, first and last number."""
        for rig, epochs in self._rigs.items():
            for name, epoch in epochs.items():
                for first, last in epoch.gaps():
                    yield rig, name, first, last
                    break

    def give_up(self) -> list[str]:
        """Forget the first rigs and give up the oldest gaps if there are too many; report both."""
        lost = list[str]()
        while len(self._rigs) > RIGS_MAX:
            lost.append(self._forget(f"there are more than {RIGS_MAX} rigs"))
        for rig, epochs in self._rigs.items():
            for name, epoch in epochs.items():
                while len(epoch.seen) > GAPS_MAX:
                    first, last = next(epoch.gaps())
                    epoch.seen.add(first, last)
                    lost.append(
                        _lost(rig, name, first, last, "given up after too many gaps without an answer")
                    )
        return lost

    def encode_limited(self) -> tuple[bytes, list[str]]:
        """Return the position as JSON of at most `FILE_MAX` bytes; report the rigs forgotten for it."""
        forgotten = list[str]()
        while len(payload := self.encode()) > FILE_MAX:
            forgotten.append(self._forget("the file would be too large"))
        return payload, forgotten

    def encode(self) -> bytes:
        """Return the position as JSON."""
        rigs: list[Json] = [
            {
                "site": site,
                "rig": rig,
                "epoch": name,
                "head": epoch.head,
                "seen": [[first, last] for first, last in epoch.seen],
            }
            for (site, rig), epochs in self._rigs.items()
            for name, epoch in epochs.items()
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
            epoch = _Epoch(RangeSet(rig.ranges("seen")), rig.integer("head", -1))
            name = rig.text("site"), rig.text("rig")
            position._rigs.setdefault(name, {})[rig.text("epoch")] = epoch
        return position

    def _forget(self, why: str) -> str:
        """Forget the rig that was added first, and report it."""
        rig = next(iter(self._rigs))
        del self._rigs[rig]
        return f"{'/'.join(rig)}: position forgotten, because {why}"

    def _epoch(self, epochs: dict[str, _Epoch], name: str) -> _Epoch:
        if name not in epochs:
            while len(epochs) >= EPOCHS_MAX:
                del epochs[next(iter(epochs))]
        return epochs.setdefault(name, _Epoch())


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


def _lost(rig: RigId, epoch: str, first: int, last: int, why: str) -> str:
    which, verb = (f"event {first}", "is") if first == last else (f"events {first} to {last}", "are")
    return f"{'/'.join(rig)}: {which} of epoch {epoch} {verb} lost: {why}"
