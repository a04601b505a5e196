"""Which slip events a service has had, and which it still misses: kept in mind, or in a file.

Pure but for `hold`, `load` and `save`; nothing here talks to a broker.
"""

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

from connectors.events import Event, encode
from connectors.fields import Fields
from connectors.mqtt.gap_request import GapAnswer
from connectors.mqtt.lock import lock_beside
from connectors.mqtt.numbers import Numbers
from operators.errors import EndpointError, InputError, os_error_reason
from operators.ports import Json

Place: TypeAlias = tuple[str, str]  # site and rig

FORMAT = 1
LARGEST = 16 * 2**20  # bytes of a file
RIGS = 1000  # that are kept in mind; those heard of longest ago are forgotten
EPOCHS = 16  # of a rig
GAPS = 1000  # of an epoch; with more the first is given up


@dataclass
class _Epoch:
    """What is known of a series of numbers."""

    seen: Numbers = field(default_factory=Numbers)
    head: int = 0  # the newest that there is

    def gaps(self) -> Iterator[tuple[int, int]]:
        return self.seen.gaps(1, max(self.head, self.seen.highest))


class Position:
    """The numbers of the events that were had, by rig and epoch.

    A rig that is heard of for the first time begins with its next event; if all is wanted, with its first.
    What its methods give are reports of what is lost for good.

    >>> position = Position()
    >>> position.announce(("lab", "ur10"), {"ab": 4})
    []
    >>> position.announce(("lab", "ur10"), {"ab": 6}), list(position.gaps())
    ([], [(('lab', 'ur10'), 'ab', 5, 6)])
    >>> position.settle(("lab", "ur10"), GapAnswer("ab", 5, 6, ((5, 5),)))
    ['lab/ur10: event 5 of epoch ab is lost: it is no longer kept']
    """

    def __init__(self, *, everything: bool = False) -> None:
        """Begin with nothing; `everything`: what there was before we first heard of a rig is missed too."""
        self._everything = everything
        self._rigs: dict[Place, dict[str, _Epoch]] = {}

    def take(self, event: Event) -> bool:
        """Note an event as had; False if it was already."""
        place, epochs = (event.site, event.rig), self._rigs.get((event.site, event.rig))
        if epochs is None:
            epochs = self._add(place)
            if not self._everything:
                epochs.setdefault(event.epoch, _Epoch()).seen.add(1, event.seq - 1)
        epoch = self._epoch(epochs, event.epoch)
        if event.seq in epoch.seen:
            return False
        epoch.seen.add(event.seq)
        return True

    def announce(self, place: Place, heads: dict[str, int]) -> list[str]:
        """A rig says which is the newest number of each of its epochs, those that it knows of."""
        epochs, lost = self._rigs.get(place), list[str]()
        if epochs is None:
            epochs = self._add(place)
            for name, head in heads.items():
                self._epoch(epochs, name).seen.add(1, 0 if self._everything else head)
        for name, head in heads.items():
            epoch = self._epoch(epochs, name)
            epoch.head = max(epoch.head, head)
        for name in [name for name in epochs if name not in heads]:
            gone = epochs.pop(name)
            ranges = [_numbers(*gap) for gap in gone.gaps()]
            which = ", ".join([*ranges, f"those after {max(gone.head, gone.seen.highest)}, if any,"])
            lost.append(f"{_name(place)}: of epoch {name}, which is no longer kept, {which} are lost")
        return lost

    def settle(self, place: Place, answer: GapAnswer) -> list[str]:
        """A rig says which of the events that were asked for are no longer kept."""
        epoch = self._rigs.get(place, {}).get(answer.epoch)
        if epoch is None:
            return []
        missing = [gap for low, high in answer.missing for gap in epoch.seen.gaps(low, high)]
        for gap in missing:
            epoch.seen.add(*gap)
        return [_lost(place, answer.epoch, *gap, "no longer kept") for gap in missing]

    def gaps(self) -> Iterator[tuple[Place, str, int, int]]:
        """The first range of events that each epoch misses."""
        for place, epochs in self._rigs.items():
            for name, epoch in epochs.items():
                for first, last in epoch.gaps():
                    yield place, name, first, last
                    break

    def give_up(self) -> list[str]:
        """Give up what would take too much memory."""
        lost = list[str]()
        for place, epochs in self._rigs.items():
            for name, epoch in epochs.items():
                while len(epoch.seen) > GAPS:
                    first, last = next(epoch.gaps())
                    epoch.seen.add(first, last)
                    lost.append(_lost(place, name, first, last, "given up: nobody answers"))
        return lost

    def encode(self) -> bytes:
        """As JSON."""
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
        """Read what `encode` writes.

        Raises:
            InputError: naming `where`, and the field that is missing or wrong.
        """
        position, fields = cls(everything=everything), Fields.parse(payload, where, largest=LARGEST)
        fields.whole("format", FORMAT, FORMAT)
        for rig in fields.objects("rigs"):
            place = rig.text("site"), rig.text("rig")
            epochs = position._rigs.setdefault(place, {})
            epochs[rig.text("epoch")] = _Epoch(Numbers(rig.ranges("seen")), rig.whole("head", 0))
        return position

    def _add(self, place: Place) -> dict[str, _Epoch]:
        while len(self._rigs) >= RIGS:
            del self._rigs[next(iter(self._rigs))]
        return self._rigs.setdefault(place, {})

    def _epoch(self, epochs: dict[str, _Epoch], name: str) -> _Epoch:
        if name not in epochs:
            while len(epochs) >= EPOCHS:
                del epochs[next(iter(epochs))]
        return epochs.setdefault(name, _Epoch())


def read_heads(fields: Fields) -> dict[str, int]:
    """The newest number of each epoch, from a rig's ``head``.

    >>> read_heads(Fields.parse(b'{"epoch":"b","last_seq":2,"before":[{"epoch":"a","last_seq":9}]}', "head"))
    {'a': 9, 'b': 2}

    Raises:
        InputError: naming the field that is missing or wrong.
    """
    before = fields.objects("before") if "before" in fields.values else []
    if len(before) >= EPOCHS:
        fields.fail("before", f"a list of less than {EPOCHS}")
    return {each.text("epoch"): each.whole("last_seq", 0) for each in (*before, fields)}


def hold(path: Path) -> int:
    """Make sure that nobody else goes on from a position; gives the descriptor to be closed.

    Raises:
        EndpointError: if somebody does, or its folder cannot be written.
    """
    try:
        return lock_beside(path)
    except BlockingIOError:
        reason = "is in use: two consumers cannot go on from one position; name another file"
        raise EndpointError(str(path), reason) from None
    except OSError as error:
        raise EndpointError(str(path), f"cannot be written: {os_error_reason(error)}") from None


def load(path: Path, *, everything: bool = False) -> Position:
    """Read a position from a file; one that is not there yet is a new one.

    Raises:
        InputError: if the file is damaged, or something else.
        EndpointError: if it cannot be read.
    """
    try:
        with path.open("rb") as file:
            payload = file.read(LARGEST + 1)
    except FileNotFoundError:
        return Position(everything=everything)
    except OSError as error:
        raise EndpointError(str(path), f"cannot be read: {os_error_reason(error)}") from None
    try:
        return Position.decode(payload, str(path), everything=everything)
    except InputError as error:
        hint = "is no position; name another file, or remove it to begin anew"
        raise InputError(str(path), f"{error.reason}: {hint}") from None


def save(path: Path, payload: bytes) -> None:
    """Replace a file, so that whatever happens it holds the old position or the new one.

    Raises:
        EndpointError: if it cannot be written.
    """
    partial = path.with_name(f"{path.name}.partial")
    try:
        with partial.open("wb") as file:
            file.write(payload)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except OSError as error:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise EndpointError(str(path), f"cannot be written: {os_error_reason(error)}") from None


def _name(place: Place) -> str:
    return "/".join(place)


def _numbers(first: int, last: int) -> str:
    return f"{first}" if first == last else f"{first} to {last}"


def _lost(place: Place, epoch: str, first: int, last: int, why: str) -> str:
    if first == last:
        return f"{_name(place)}: event {first} of epoch {epoch} is lost: it is {why}"
    return f"{_name(place)}: events {first} to {last} of epoch {epoch} are lost: they are {why}"
