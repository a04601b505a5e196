"""Power cuts during a recording: durable rows survive, and no wrong row is read."""

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
SYNC = 13  # rows of each stream between two fsyncs; not a divisor of the part size
PART = 20  # rows
TAILS: tuple[Tail, ...] = get_args(Tail)
OTHERS = "plain Arrow IPC with a tail of zeros: wrong rows in 128 of 193"


@dataclass
class Findings:
    """Findings of all disk images."""

    rows: int  # of each stream, at most
    images: int = 0
    wrong: int = 0  # rows that were not written, or not at this position
    short: int = 0  # images with fewer rows than were durable
    unreadable: list[str] = field(default_factory=list[str])

    def __post_init__(self) -> None:
        """Make the expected rows."""
        numbers = range(self.rows)
        self._right = [concat(kind, [row(kind, number) for number in numbers]) for kind, _ in STREAMS]

    def check(self, image: Path, durable: int) -> None:
        """Check that an image has at least `durable` rows of each stream; then delete it."""
        self.images += 1
        try:
            if (image / "session.json").exists():
                for rows, expected in zip(read(image).rows, self._right, strict=True):
                    same = not len(rows) or alike(rows, expected[: len(rows)])
                    self.wrong += 0 if same else len(rows)
                    self.short += len(rows) < durable
            else:
                self.short += durable > 0
        except Exception as error:  # noqa: BLE001 - none is allowed
            reason = str(error) if isinstance(error, SlipflowError) else f"{type(error).__name__}: {error}"
            self.unreadable.append(reason)
        rmtree(image)

    def promise(self, claim: str, others: str = "") -> Promise:
        """Return the result of the test."""
        first = f"; the first: {self.unreadable[0]}" if self.unreadable else ""
        return Promise(
            f"power cut: {claim}; {self.images} disk images",
            f"{self.wrong} wrong rows, {len(self.unreadable)} unreadable, {self.short} with fewer rows"
            f" than were durable{first}",
            "0, 0, 0",
            passed=not (self.wrong or self.unreadable or self.short),
            others=others,
        )


def tails(scale: Scale) -> Promise:
    """Replace the end of the journal by nothing, zeros or garbage."""
    random = np.random.default_rng(scale.seed)
    before, after = (30, 30) if scale.short else (150, 120)  # rows of each stream: 120 in about a second
    found = Findings(before + after)
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

        disk.image(folder / "complete", lambda: True, measure)
        size = max(sizes)
        for at in range(0, size, STEP * 16 if scale.short else STEP):
            for tail in TAILS:
                disk.image(folder / "cut", lambda: True, partial(end, at=at, tail=tail, random=random))
                found.check(folder / "cut", before)
        unclosed: Any = writer
        unclosed._release()
    return found.promise(
        f"the last {size} bytes missing, zero or random, from every {STEP}th byte on", OTHERS
    )


def lives(scale: Scale) -> Promise:
    """Cut the power at each step from the start to the end of a session."""
    random, found = np.random.default_rng(scale.seed), Findings(30 if scale.short else 90)
    durable, reached = 0, 0

    def fail(disk: Disk) -> None:
        nonlocal reached
        reached += 1
        if scale.short and reached % 20:
            return
        image = disk.folder.parents[2] / "image"
        probabilities = (
            [0.0, 1.0] if scale.short else [0.0, 1.0, *[0.5] * 4]
        )  # that a name keeps its present state
        for probability in probabilities:
            disk.image(image, partial(_happens, random, probability), partial(_end, random))
            found.check(image, durable)

    with scratch(memory=True) as folder, _watched(folder, fail):
        writer = begin(folder / "data", part_rows=PART)
        for number in range(found.rows):
            write(writer, number)
            if number % SYNC == SYNC - 1:
                _make_durable(writer)
                durable = number + 1
        writer.close()
    return found.promise(f"at {reached} steps from the start to the end of a session")


def replays(scale: Scale) -> Promise:
    """Cut the power at each step of a replay, which is made durable as a whole at its end."""
    random, rows = np.random.default_rng(scale.seed), 30 if scale.short else 90
    expected = [concat(kind, [row(kind, number) for number in range(rows)]) for kind, _ in STREAMS]
    images = complete = partial_ones = refused = wrong = 0

    def fail(disk: Disk) -> None:
        nonlocal images, complete, partial_ones, refused, wrong
        image = disk.folder.parents[2] / "image"
        for probability in (0.0, 1.0) if scale.short else (0.0, 1.0, 0.5, 0.5, 0.5, 0.5):
            disk.image(image, partial(_happens, random, probability), partial(_end, random))
            images += 1
            try:
                found = read(image)
            except SlipflowError:
                refused += 1
            else:
                pairs = list(zip(found.rows, expected, strict=True))
                same = all(not len(a) or alike(a, b[: len(a)]) for a, b in pairs)
                whole_rows = all(len(a) == len(b) for a, b in pairs)
                marked = found.about["complete"] is not True
                complete, partial_ones = complete + (not marked), partial_ones + marked
                wrong += not (same and (marked or whole_rows))
            rmtree(image)

    with scratch(memory=True) as folder, _watched(folder, fail):
        writer = begin(folder / "data", part_rows=PART, live=False)
        for number in range(rows):
            write(writer, number)
        writer.close()
    return Promise(
        f"power cut: at any step of a replay; {images} disk images",
        f"{wrong} wrong without a message; {complete} complete, {partial_ones} marked incomplete,"
        f" {refused} refused",
        "0 wrong without a message",
        passed=not wrong and complete > 0,
    )


@contextmanager
def _watched(folder: Path, fail: Callable[[Disk], None]) -> Generator[Disk]:
    """Record the fsyncs of the session in `folder`; call `fail` at each of its steps."""
    disk, mine, failing = Disk(folder / "data/sessions" / NAME), get_ident(), False

    def reach(_: str) -> None:
        nonlocal failing
        if not failing and get_ident() == mine and disk.folder.exists():
            failing = True  # reading an image has steps, too
            fail(disk)
            failing = False

    with disk.watched(), observed(reach):
        yield disk


def _make_durable(writer: SessionWriter) -> None:
    """Make all written rows durable."""
    writer.sync()


def _happens(random: np.random.Generator, probability: float) -> bool:
    return bool(random.random() < probability)


def _end(random: np.random.Generator, rest: bytes) -> bytes:
    """Return a random end of unsynced bytes."""
    at = int(random.integers(len(rest) + 1))
    return end(rest, at, TAILS[random.integers(len(TAILS))], random)


PROMISES = (tails, lives, replays)
