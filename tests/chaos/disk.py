"""The disk is full for a while: recording stops cleanly, nothing else does, and it goes on by itself."""

import json
import subprocess
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from operators import EVERY, Motion, Touch, concat, s
from storage import Session, verify
from storage.verification import LOSSY
from tests.chaos import fill
from tests.chaos.numbered import alike, motion, touch
from tests.chaos.processes import finish, scratch, start
from tests.chaos.promise import Promise
from tests.chaos.scale import Scale

SIZE = "1m"
CALLED = {"tmpfs": "a tmpfs of 1 MiB", "limit": "no file may grow: no tmpfs could be mounted"}
OTHERS = "ParquetWriter took 12,200 rows, 0 readable"


@dataclass(frozen=True)
class Kept:
    """What can be read of the recording."""

    rows: int  # of touch, motion and samples
    wrong: int  # rows of touch and motion that are not as they were given
    newest: int  # number of the newest touch
    code: int  # of verify


def full_for_a_while(scale: Scale) -> Promise:
    """The disk is full, then there is room again."""
    full, room = (1.0, 1.5) if scale.short else (5.0, 5.0)
    with _small_disk() as (folder, how):
        told = _run(folder, how, full, room)
        kept = _look(folder)
    during, after = (told[each][fill.NAME]["error"] for each in ("health", "after"))
    again = (
        "works again" if after is None and kept.newest + 1 == told["given"]["touch"] else "NEVER works again"
    )
    return _promise(
        f"disk full for {full:g} s ({CALLED[how]}), then room",
        told,
        kept,
        f"health says {(during or 'nothing').rpartition(': ')[2]!r}, {again}",
        kept_too=during is not None and again == "works again",
    )


def full_until_the_end(scale: Scale) -> Promise:
    """The disk is full, and so the run ends; then there is room to recover it."""
    full = 1.0 if scale.short else 5.0
    with _small_disk() as (folder, how):
        told = _run(folder, how, full, 0)
        kept = _look(folder)
    error = told["sink"][fill.NAME]["error"]
    return _promise(
        f"disk full until the end ({CALLED[how]}), then recovered",
        told,
        kept,
        f"it ends with {error.rpartition(': ')[2]!r}",
        kept_too=bool(error),
    )


def _promise(claim: str, told: Any, kept: Kept, seen: str, *, kept_too: bool) -> Promise:  # noqa: ANN401 - JSON
    felt, alerts, dropped = told["given"]["touch"], told["alerts"], told["sink"][fill.NAME]["dropped"]
    lost = felt + told["given"]["motion"] + felt - kept.rows - dropped  # each touch makes a sample
    return Promise(
        claim,
        f"{seen}; {alerts} of {felt} alerts, {told['during']} of them meanwhile; {kept.rows} rows readable,"
        f" {kept.wrong} wrong, {dropped} counted as dropped, {lost} neither; verify {kept.code}",
        f"health says so; each alert; 0 wrong, 0 neither; verify {LOSSY}",
        kept=kept_too and alerts == felt and told["during"] > 0 and dropped > 0
        and not lost and not kept.wrong and kept.code == LOSSY,
        others=OTHERS,
    )  # fmt: skip


def _run(folder: Path, how: str, full: float, room: float) -> Any:  # noqa: ANN401 - JSON
    return json.loads(finish(start("fill", folder, how, f"{full}", f"{room}"), full + room))


def _look(folder: Path) -> Kept:
    """Read the session, which is put right first where it was not closed."""
    session = Session.open(folder / "data" / "sessions" / fill.SESSION)
    felt = concat(Touch, list(session.read(Touch, 0)))
    moved = concat(Motion, list(session.read(Motion, EVERY)))
    numbers = np.rint((felt.time - felt.time[0]) * fill.RATE / s).astype(np.int64)
    right = alike(felt, touch(numbers, felt.time)), alike(moved, motion(moved.device_time, moved.time))
    rising = [bool((np.diff(each) > 0).all()) for each in (numbers, moved.device_time)]
    rows = len(felt), len(moved)
    wrong = sum(size for size, good, up in zip(rows, right, rising, strict=True) if not (good and up))
    samples = len(session.frame("samples"))
    return Kept(sum(rows) + samples, wrong, int(numbers[-1]), verify(session.folder).code)


@contextmanager
def _small_disk() -> Generator[tuple[Path, str]]:
    """A folder on a file system of 1 MiB where one may be mounted; and how it is to be filled."""
    with scratch() as folder:
        command = ["mount", "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", str(folder)]
        try:
            mounted = not subprocess.run(command, capture_output=True, check=False).returncode
        except OSError:
            mounted = False
        try:
            yield folder, "tmpfs" if mounted else "limit"
        finally:
            if mounted:
                subprocess.run(["umount", "--lazy", str(folder)], capture_output=True, check=True)


PROMISES = (full_for_a_while, full_until_the_end)
