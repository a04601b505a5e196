"""Power cuts at each step of a recording: durable rows survive, and no wrong row is read."""

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from shutil import rmtree
from threading import get_ident
from typing import Final

import numpy as np

from operators import EVERY, Batch, Episodes, Motion, SlipflowError, Slips, Touch, concat
from storage import Session
from tests.chaos.power import TAILS, Disk, end
from tests.chaos.processes import scratch
from tests.chaos.run import Promise, Scale
from tests.storage.disk_steps import ROWS, observed, record, row
from tests.storage.made import new_run

STREAMS: Final[tuple[tuple[type[Batch], int], ...]] = (
    (Touch, 0),
    (Motion, EVERY),
    (Slips, 0),
    (Episodes, EVERY),
)
PROBABILITIES: Final = (0.0, 1.0, 0.5, 0.5, 0.5, 0.5)  # that a name keeps its present state


def lives(scale: Scale) -> Sequence[Promise]:
    """Cut the power at each step from the start to the end of a live recording."""
    durable, steps, images, short = list[int](), 0, 0, 0
    wrong = list[str]()

    def check(image: Path) -> None:
        nonlocal images, short
        images += 1
        if not (image / "session.json").exists():
            short += bool(durable)
            return
        try:
            counts = _count(image)
        except Exception as error:  # noqa: BLE001 - none is allowed
            wrong.append(f"{type(error).__name__}: {error}")
        else:
            short += min(counts) < max(durable, default=0)

    def cut(take_image: Callable[[float, Callable[[Path], None]], None]) -> None:
        nonlocal steps
        steps += 1
        if not scale.short or steps % 20 == 0:
            for probability in PROBABILITIES[: 2 if scale.short else None]:
                take_image(probability, check)

    with _watched(scale.seed, cut) as root:
        record(root, new_run(), [], durable)
    return [
        Promise(
            f"power cut: at {steps} steps of a recording; {images} disk images",
            f"{len(wrong)} wrong or unreadable, {short} with fewer rows than were durable {wrong[:1] or ''}",
            "0, 0",
            passed=not wrong and not short,
        )
    ]


def replays(scale: Scale) -> Sequence[Promise]:
    """Cut the power at each step of a replay, which is made durable as a whole at its end."""
    images = complete = refused = wrong = 0

    def check(image: Path) -> None:
        nonlocal images, complete, refused, wrong
        images += 1
        try:
            counts, whole = _count(image), Session.open(image).about["complete"] is True
        except SlipflowError:
            refused += 1
        except AssertionError:
            wrong += 1
        else:
            complete += whole
            wrong += whole and set(counts) != {ROWS}

    def cut(take_image: Callable[[float, Callable[[Path], None]], None]) -> None:
        for probability in PROBABILITIES[: 2 if scale.short else None]:
            take_image(probability, check)

    with _watched(scale.seed, cut) as root:
        record(root, new_run(live=False), [])
    return [
        Promise(
            f"power cut: at any step of a replay; {images} disk images",
            f"{wrong} wrong without a message; {complete} complete, {refused} refused",
            "0 wrong without a message",
            passed=not wrong and complete > 0,
        )
    ]


def _count(image: Path) -> list[int]:
    """Return the number of rows of each stream.

    Raises:
        SlipflowError: if the session cannot be read.
        AssertionError: if a row is wrong.
    """
    session, counts = Session.open(image), list[int]()
    for kind, finger in STREAMS:
        found = concat(kind, list(session.read(kind, finger)))
        expected = concat(kind, [row(kind, number) for number in range(len(found))])
        for name in vars(found):
            values, right = getattr(found, name), getattr(expected, name)
            assert name == "finger" or values.tobytes() == right.tobytes(), name
        counts.append(len(found))
    return counts


@contextmanager
def _watched(
    seed: int, cut: Callable[[Callable[[float, Callable[[Path], None]], None]], None]
) -> Generator[Path]:
    """Yield the folder of a dataset; call `cut` at each step of its session with a function for images."""
    random, failing, mine = np.random.default_rng(seed), False, get_ident()

    def left(rest: bytes) -> bytes:
        at = int(random.integers(len(rest) + 1))
        return end(rest, at, TAILS[random.integers(len(TAILS))], random)

    with scratch(memory=True) as folder:
        disk, image = Disk(folder / "data/sessions/one"), folder / "image"

        def take_image(probability: float, check: Callable[[Path], None]) -> None:
            disk.image(image, lambda: bool(random.random() < probability), left)
            check(image)
            rmtree(image)

        def reach(_: str) -> None:
            nonlocal failing
            if not failing and get_ident() == mine and disk.folder.exists():
                failing = True  # reading an image has steps, too
                cut(take_image)
                failing = False

        with disk.watched(), observed(reach):
            yield folder / "data"
