"""The power fails while a session is recorded: what was made durable is there, and nothing is made up."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from shutil import rmtree
from threading import get_ident
from typing import Any, get_args

import numpy as np

from operators import SlipflowError, concat
from storage.writer import SessionWriter
from tests.chaos.numbered import alike
from tests.chaos.power import Disk, Tail, end
from tests.chaos.processes import scratch
from tests.chaos.promise import Promise
from tests.chaos.scale import Scale
from tests.chaos.session import NAME, STREAMS, begin, read, row, write
from tests.storage.disk_steps import observed

STEP = 64  # bytes
SYNC = 13  # rows of each stream, after which they are made durable; parts do not end with them
PART = 20  # rows
TAILS: tuple[Tail, ...] = get_args(Tail)
OTHERS = "after zeros plain IPC gave wrong rows in 128 of 193"


@dataclass
class Found:
    """What came of all images."""

    rows: int  # of each stream, that may be there
    images: int = 0
    wrong: int = 0  # rows that were never written, or not in this place
    short: int = 0  # images with fewer rows than were durable
    unreadable: list[str] = field(default_factory=list[str])

    def __post_init__(self) -> None:
        """Know what is right."""
        numbers = range(self.rows)
        self._right = [concat(kind, [row(kind, number) for number in numbers]) for kind, _ in STREAMS]

    def look(self, image: Path, durable: int) -> None:
        """Read an image, which should have so many rows of each stream at least; then delete it."""
        self.images += 1
        try:
            if (image / "session.json").exists():
                for rows, right in zip(read(image).rows, self._right, strict=True):
                    same = not len(rows) or alike(rows, right[: len(rows)])
                    self.wrong += 0 if same else len(rows)
                    self.short += len(rows) < durable
            else:
                self.short += durable > 0
        except Exception as error:  # noqa: BLE001 - none may come, whatever it is
            told = str(error) if isinstance(error, SlipflowError) else f"{type(error).__name__}: {error}"
            self.unreadable.append(told)
        rmtree(image)

    def promise(self, claim: str, others: str = "") -> Promise:
        """What it says of the promise."""
        first = f"; the first: {self.unreadable[0]}" if self.unreadable else ""
        return Promise(
            f"power cut: {claim}, {self.images} images",
            f"{self.wrong} wrong rows, {len(self.unreadable)} unreadable, {self.short} short{first}",
            "0 wrong, 0 unreadable, 0 with fewer rows than were durable",
            kept=not (self.wrong or self.unreadable or self.short),
            others=others,
        )


def tails(scale: Scale) -> Promise:
    """The end of the journal is cut off, zero or garbage."""
    random = np.random.default_rng(scale.seed)
    before, after = (30, 30) if scale.short else (150, 120)  # rows of each stream: 120 are about a second's
    found = Found(before + after)
    with scratch(memory=True) as folder, _watched(folder, lambda _: None) as disk:
        writer = begin(folder / "data")
        for number in range(before + after):
            if number == before:
                _make_durable(writer)
            write(writer, number)
        sizes = list[int]()

        def measure(rest: bytes) -> bytes:
            sizes.append(len(rest))
            return rest

        disk.image(folder / "whole", lambda: True, measure)
        size = max(sizes)
        for at in range(0, size, STEP * 16 if scale.short else STEP):
            for tail in TAILS:
                disk.image(folder / "cut", lambda: True, partial(end, at=at, tail=tail, random=random))
                found.look(folder / "cut", before)
        unclosed: Any = writer
        unclosed._release()
    return found.promise(f"the last {size} bytes cut, zero or garbage from every {STEP}th on", OTHERS)


def lives(scale: Scale) -> Promise:
    """The power fails at any step of a session's life."""
    random, found = np.random.default_rng(scale.seed), Found(30 if scale.short else 90)
    durable, reached = 0, 0

    def fail(disk: Disk) -> None:
        nonlocal reached
        reached += 1
        if scale.short and reached % 20:
            return
        place = disk.folder.parents[2] / "image"
        chances = [0.0, 1.0] if scale.short else [0.0, 1.0, *[0.5] * 4]  # that a name is as it is now
        for chance in chances:
            disk.image(place, partial(_chance, random, chance), partial(_end, random))
            found.look(place, durable)

    with scratch(memory=True) as folder, _watched(folder, fail):
        writer = begin(folder / "data", part_rows=PART)
        for number in range(found.rows):
            write(writer, number)
            if number % SYNC == SYNC - 1:
                _make_durable(writer)
                durable = number + 1
        writer.close()
    return found.promise(f"at {reached} steps of a session's life")


def replays(scale: Scale) -> Promise:
    """The power fails at any step of a replay, which is made durable all at once at its end."""
    random, rows = np.random.default_rng(scale.seed), 30 if scale.short else 90
    right = [concat(kind, [row(kind, number) for number in range(rows)]) for kind, _ in STREAMS]
    images = whole = partial_ones = refused = wrong = 0

    def fail(disk: Disk) -> None:
        nonlocal images, whole, partial_ones, refused, wrong
        place = disk.folder.parents[2] / "image"
        for chance in (0.0, 1.0) if scale.short else (0.0, 1.0, 0.5, 0.5, 0.5, 0.5):
            disk.image(place, partial(_chance, random, chance), partial(_end, random))
            images += 1
            try:
                found = read(place)
            except SlipflowError:
                refused += 1
            else:
                pairs = list(zip(found.rows, right, strict=True))
                same = all(not len(a) or alike(a, b[: len(a)]) for a, b in pairs)
                there = all(len(a) == len(b) for a, b in pairs)
                said = found.about["complete"] is not True
                whole, partial_ones = whole + (not said), partial_ones + said
                wrong += not (same and (said or there))
            rmtree(place)

    with scratch(memory=True) as folder, _watched(folder, fail):
        writer = begin(folder / "data", part_rows=PART, live=False)
        for number in range(rows):
            write(writer, number)
        writer.close()
    return Promise(
        f"power cut: at any step of a replay, {images} images",
        f"{wrong} silently wrong; {whole} whole, {partial_ones} said to be incomplete, {refused} refused",
        "0 silently wrong",
        kept=not wrong and whole > 0,
    )


@contextmanager
def _watched(folder: Path, fail: Callable[[Disk], None]) -> Generator[Disk]:
    """What is done to the session in `folder` is known; `fail` is called at each step of it."""
    disk, mine, failing = Disk(folder / "data/sessions" / NAME), get_ident(), False

    def reach(_: str) -> None:
        nonlocal failing
        if not failing and get_ident() == mine and disk.folder.exists():
            failing = True  # reading an image takes steps, too
            fail(disk)
            failing = False

    with disk.watched(), observed(reach):
        yield disk


def _make_durable(writer: SessionWriter) -> None:
    """All rows that were written, now."""
    writer.sync()


def _chance(random: np.random.Generator, chance: float) -> bool:
    return bool(random.random() < chance)


def _end(random: np.random.Generator, rest: bytes) -> bytes:
    """Any end."""
    at = int(random.integers(len(rest) + 1))
    return end(rest, at, TAILS[random.integers(len(TAILS))], random)


PROMISES = (tails, lives, replays)
